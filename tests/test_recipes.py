"""Recipes: as JSON, fitted to other sizes, and amounts of them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from supple.deformation import Deformation
from supple.strokes import Recipe, Stroke
from tests.strokes import grab, recipes, refusal


class TestRecipe:
    def test_defaults(self) -> None:
        assert Recipe() == Recipe(border="auto", border_profile="quartic", on_fold="flow", strokes=())
        assert Recipe(strokes=[grab()]).strokes == (grab(),)  # type: ignore[arg-type]
        assert Recipe(strokes=(s for s in [grab()])).strokes == (grab(),)  # type: ignore[arg-type]
        assert hash(Recipe(border=None)) == hash(Recipe(border=None))

    def test_refuses_what_domains_refuse(self) -> None:
        assert refusal(lambda: Recipe(border=-1)).startswith("border must be ")
        assert refusal(lambda: Recipe(border_profile="SINE")).startswith("border_profile must be ")  # type: ignore[arg-type]
        assert refusal(lambda: Recipe(on_fold="stop")).startswith("on_fold must be ")  # type: ignore[arg-type]

    @pytest.mark.parametrize("bad", [None, 5, [None], "ab", {"at": 1}, [grab(), (1, 2)]])
    def test_refuses_strokes(self, bad: Any) -> None:
        assert refusal(lambda: Recipe(strokes=bad)).startswith("strokes")

    def test_refuses_mixed_dimensions(self) -> None:
        mixed = (grab(), grab(at=(1, 2, 3), by=(1, 2, 3)))
        assert refusal(lambda: Recipe(strokes=mixed)) == (
            "strokes[1].at must be a point of 2 numbers, as in strokes[0], found (1.0, 2.0, 3.0)"
        )


GRAB = '{"brush": "grab", "at": [256, 256], "by": [0, 90], "radius": 100, "poisson": 0.4, "scales": 1}'


def with_stroke(entry: str) -> str:
    return f'{{"supple": 2, "strokes": [{GRAB}, {entry}]}}'


def with_field(name: str, value: str) -> str:
    entry = {key: json.dumps(item) for key, item in json.loads(GRAB).items()}
    entry[name] = value
    return with_stroke("{" + ", ".join(f'"{key}": {item}' for key, item in entry.items()) + "}")


def read_refusal(text: Any) -> str:
    return refusal(lambda: Recipe.from_json(text))


class TestJson:
    def test_what_is_written(self) -> None:
        strokes = (grab(), grab(at=(0.1, -0.0), radius=1e22, reach=None, poisson=-math.inf, scales=3))
        assert Recipe(strokes=strokes).to_json() == (
            "{\n"
            '  "supple": 3,\n'
            '  "border": "auto",\n'
            '  "border_profile": "quartic",\n'
            '  "on_fold": "flow",\n'
            '  "amount": 1,\n'
            '  "strokes": [\n'
            '    {"brush": "grab", "at": [256, 256], "by": [0, 90], "radius": 100, "scales": 1, "reach": 4, '
            '"poisson": null, "strength": 1},\n'
            '    {"brush": "grab", "at": [0.1, -0.0], "by": [0, 90], "radius": 1e+22, "scales": 3, "reach": null, '
            '"poisson": "-inf", "strength": 1}\n'
            "  ]\n"
            "}\n"
        )
        assert json.loads(Recipe(border=None).to_json()) == {
            "supple": 3, "border": None, "border_profile": "quartic", "on_fold": "flow", "amount": 1, "strokes": [],
        }  # fmt: skip

    @given(recipes())
    def test_round_trip(self, recipe: Recipe) -> None:
        text = recipe.to_json()
        again = Recipe.from_json(text)
        assert again == recipe
        assert repr(again) == repr(recipe)  # the sign of zero too
        assert again.to_json() == text

        def refuse(token: str) -> None:
            raise AssertionError(token)

        json.loads(text, parse_constant=refuse)

    def test_only_hidden_strokes_say_so(self) -> None:
        text = Recipe(strokes=(grab(), grab(hidden=True))).to_json()
        shown, hidden = text.splitlines()[-4:-2]
        assert hidden == shown.replace("},", ', "hidden": true}')
        assert Recipe.from_json(text.replace("true", "false")) == Recipe(strokes=(grab(), grab()))

    @pytest.mark.parametrize("border", [20.0, None])
    def test_version_1_has_the_border_of_the_paper(self, border: float | None) -> None:
        old = f'{{"supple": 1, "border": {json.dumps(border)}, "strokes": [{GRAB}]}}'
        recipe = Recipe.from_json(old)
        assert recipe == Recipe(
            border=border, border_profile="sine", on_fold="damp", strokes=(grab(poisson=0.4, reach=None),)
        )
        text = recipe.to_json()
        assert Recipe.from_json(text) == recipe

    def test_older_versions_take_newer_keys(self) -> None:
        old = f'{{"supple": 1, "border_profile": "quartic", "strokes": [{GRAB[:-1]}, "reach": 4, "strength": 0.5}}]}}'
        recipe = Recipe.from_json(old)
        assert (recipe.border, recipe.border_profile) == (50, "quartic")
        assert recipe.strokes == (grab(poisson=0.4, strength=0.5),)

    def test_twists_of_version_2_move_points_along_chords(self) -> None:
        text = '{"supple": 2, "strokes": [{"brush": "twist", "at": [30, 30], "angle": 90, "radius": 9}]}'
        old = Recipe.from_json(text)
        assert old.strokes == (replace(Stroke.twist((30, 30), angle=90, radius=9), chord=True),)
        assert Recipe.from_json(old.to_json()) == old
        new = Recipe.from_json(text.replace('"supple": 2', '"supple": 3'))
        assert "chord" not in new.to_json()
        assert Recipe.from_json(new.to_json()) == new
        shrunk, kept = (
            np.linalg.norm(Deformation.from_recipe(r, (61, 61)).forward((36, 30)) - (30, 30)) for r in (old, new)
        )
        assert shrunk < 5.9
        assert kept == pytest.approx(6, abs=1e-12)
        assert read_refusal(with_stroke(GRAB[:-1] + ', "chord": true}')) == (
            "strokes[1]: chord must be left out for a grab, found True"
        )

    def test_what_may_be_left_out(self) -> None:
        text = '{"strokes": [{"radius": 100, "by": [0, 90], "at": [256.0, 256], "brush": "grab"}], "supple": 2}'
        assert Recipe.from_json(text) == Recipe(strokes=(grab(),))
        assert Recipe.from_json('{"supple": 1, "border": null, "strokes": []}').border is None

    @pytest.mark.parametrize("key", ["brush", "at", "by", "radius"])
    def test_missing_keys_of_strokes(self, key: str) -> None:
        entry = json.loads(GRAB)
        del entry[key]
        assert read_refusal(with_stroke(json.dumps(entry))) == f'the key "{key}" is missing in strokes[1]'

    def test_unknown_brushes(self) -> None:
        entry = '{"brush": "twirl", "at": [1, 2], "radius": 5, "angle": 4}'
        assert read_refusal(with_stroke(entry)) == (
            'strokes[1]: brush must be "grab" or "twist" or "scale" or "pinch" or "freeze", found \'twirl\''
        )

    def test_missing_keys(self) -> None:
        assert read_refusal('{"supple": 1}') == 'the key "strokes" is missing in the recipe'
        assert read_refusal('{"strokes": []}').startswith('the key "supple", a recipe\'s version (3), is missing')
        assert read_refusal("{}").endswith("is missing in {}")

    @pytest.mark.parametrize("version", ["4", "0", "-1", "1.0", "true", "null", '"1"', "[1]", "9" * 5000])
    def test_other_versions(self, version: str) -> None:
        message = read_refusal(f'{{"supple": {version}, "new": 1, "strokes": []}}')
        assert message.startswith('"supple" must be 1, 2 or 3 (the versions that this release reads), found ')

    @pytest.mark.parametrize(
        ("key", "hint"),
        [("radus", '"radius"'), ("Poisson", '"poisson"'), ("scale", '"scales"'),
         ("", "known are brush, at, by"), ("zzzz", "known are"), ("line\\nbreak", "known are"),
         ("\\ud800", "known are"), ("k" * 100_000, "known are")],
    )  # fmt: skip
    def test_unknown_keys_of_strokes(self, key: str, hint: str) -> None:
        message = read_refusal(with_field(key, "1"))
        assert message.startswith("unknown key ")
        assert "in strokes[1]: " in message
        assert hint in message

    def test_unknown_keys(self) -> None:
        message = read_refusal('{"supple": 1, "on_folds": "damp", "strokes": []}')
        assert message == "unknown key 'on_folds' in the recipe: did you mean \"on_fold\"?"

    def test_duplicate_keys(self) -> None:
        message = read_refusal('{"supple": 1, "border": 1, "border": 1, "strokes": []}')
        assert message == "the key 'border' is given twice in one object of the recipe"
        assert "'radius'" in read_refusal(with_field("radius", '3, "radius": 3'))

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            *[("at", v) for v in ("1", "null", '"ab"', "[1]", "[1, 2, 3, 4]", '{"x": 1, "y": 2}')],
            *[("at", v) for v in ("[1, true]", '[1, "2"]', "[1, null]", "[1, 1e999]", "[1, [2]]")],
            ("at", f"[1, {'9' * 5000}]"),
            *[("by", v) for v in ("[1, 2, 3]", "[true, 1]", "[[1, 2]]", "{}")],
            *[("radius", v) for v in ("0", "-1", "true", '"100"', "null", "[1]", "{}", "1e999", "1e-400")],
            ("radius", "9" * 401),
            *[("poisson", v) for v in ("0.51", '"inf"', '"0.4"', "true", "[0]")],
            *[("scales", v) for v in ("0", "4", "1.0", "true", '"1"', "null", "9" * 5000)],
            *[("hidden", v) for v in ("0", "1", "null", '"true"', "[]")],
            *[("brush", v) for v in ('"bend"', "1", "null", "[]", '"' + "x" * 10_000 + '"')],
            *[("strength", v) for v in ("2.01", "-1.1", "true", "null", '"1"')],
            *[("name", v) for v in ("1", "true", "[]")],
        ],
    )  # fmt: skip
    def test_wrong_values_of_strokes(self, name: str, value: str) -> None:
        assert read_refusal(with_field(name, value)).startswith(f"strokes[1]: {name}")

    @pytest.mark.parametrize(
        ("name", "value"),
        [("border", "0"), ("border", "true"), ("border", '"none"'), ("border", "1e999"), ("on_fold", "null"),
         ("on_fold", '"dump"'), ("strokes", "{}"), ("strokes", "null"), ("strokes", '"ab"'),
         ("strokes", "[1]"), ("strokes", "[[]]")],
    )  # fmt: skip
    def test_wrong_values(self, name: str, value: str) -> None:
        entry = {"supple": "1", "strokes": "[]", name: value}
        text = "{" + ", ".join(f'"{key}": {item}' for key, item in entry.items()) + "}"
        assert read_refusal(text).startswith(f"{name}")

    @pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity"])
    def test_tokens_that_json_has_not(self, token: str) -> None:
        assert f"strict JSON, found {token}" in read_refusal(with_field("poisson", token))

    @pytest.mark.parametrize(
        ("text", "place"),
        [("", "line 1, column 1"), ("{", "line 1, column 2"), ('{\n  "supple": 1,\n  x', "line 3, column 3"),
         ("\ufeff{}", "line 1, column 1"), ("\x00\x01", "line 1, column 1"), ("{} {}", "line 1, column 4"),
         ('{"supple": 1, "strokes": [],}', "line 1, column"), ('{"a": "\x07"}', "line 1, column 8"),
         ("'single'", "line 1, column 1"), ("0x10", "line 1, column 2")],
    )  # fmt: skip
    def test_not_json(self, text: str, place: str) -> None:
        message = read_refusal(text)
        assert message.startswith("a recipe must be JSON: ")
        assert place in message

    @pytest.mark.parametrize("text", ["[]", "1", "null", "9" * 5000, None, b"{}", {"supple": 1}])
    def test_no_object_and_no_text(self, text: Any) -> None:
        assert read_refusal(text).startswith("a recipe must be ")

    @pytest.mark.parametrize("text", ["[" * 200_000, '{"a":' * 200_000, "[" * 200_000 + "]" * 200_000])
    def test_deep_garbage(self, text: str) -> None:
        assert read_refusal(text) == "a recipe must be JSON: it is nested too deeply"

    @given(
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
            lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["border", "strokes", "at", "x"]), inner),
        )
    )
    def test_any_other_json(self, data: object) -> None:
        read_refusal(json.dumps(data))
        read_refusal(with_stroke(json.dumps(data)))

    @given(st.text())
    def test_any_other_text(self, text: str) -> None:
        read_refusal(text)

    @given(recipes(), st.data())
    def test_truncated(self, recipe: Recipe, data: st.DataObject) -> None:
        text = recipe.to_json()
        read_refusal(text[: data.draw(st.integers(0, len(text) - 3))])


class TestFields:
    def test_to_in_the_place_of_by(self) -> None:
        entry = GRAB.replace('"by": [0, 90]', '"to": [256, 346]')
        assert Recipe.from_json(with_stroke(entry)).strokes[1] == grab(poisson=0.4)
        both = '"to": [256, 346], "by": [0, 90]'
        assert read_refusal(with_stroke(GRAB.replace('"by": [0, 90]', both))) == (
            'strokes[1]: a grab takes one of "to" and "by", found both'
        )
        assert read_refusal(with_stroke(entry.replace("346]", "346, 1]"))).startswith(
            "strokes[1]: to must be 2 numbers"
        )

    @pytest.mark.parametrize(
        ("name", "value", "message"),
        [
            ("amount", "2.5", "amount must be a number from -1 (the opposite) to 2, found 2.5"),
            ("amount", "true", "amount must be a number from -1 (the opposite) to 2, found True"),
            ("space", '"mm"', 'space must be "pixels" or "LPS" or "RAS", found '),
            ("space", '"RAS"', 'space must be "pixels" where points have 2 numbers, found '),
            ("size", "[640]", "size must be 2 numbers of samples, x first, found [640]"),
            ("size", "[640, 480, 9]", "size must be 2 numbers of samples"),
            ("size", "[640, 0]", "size[1] must be an integer from 1 to "),
            ("size", "[640, 480.5]", "size[1] must be an integer from 1 to "),
        ],
    )
    def test_wrong_values(self, name: str, value: str, message: str) -> None:
        assert read_refusal(f'{{"supple": 2, "{name}": {value}, "strokes": [{GRAB}]}}').startswith(message)


CHEEKS = Recipe(
    size=(340, 390),
    strokes=(
        Stroke.grab((150, 180), to=(190, 185), radius=20),
        Stroke.grab((188, 186), to=(170, 230), radius=25),
    ),
)
BESIDE_EDGES = replace(  # from the edge, to it, and along it
    CHEEKS,
    strokes=(
        Stroke.grab((0, 60), to=(31, 72), radius=20),
        Stroke.grab((40, 350), to=(47, 389), radius=25),
        Stroke.grab((338.5, 100), to=(339, 160), radius=25, reach=None),
    ),
)


class TestFitted:
    @pytest.mark.parametrize("border", ["auto", 40.0, (30.0, 40.0), None])
    @pytest.mark.parametrize("factor", [6.0, 3.0, 0.5])
    @pytest.mark.parametrize("recipe", [CHEEKS, BESIDE_EDGES], ids=["middle", "edges"])
    def test_the_result_is_the_same_at_another_size(self, recipe: Recipe, border: Any, factor: float) -> None:
        recipe = replace(recipe, border=border)
        size = (round(340 * factor), round(390 * factor))
        fitted = recipe.fitted(size)
        small = Deformation.from_recipe(recipe, (390, 340))
        big = Deformation.from_recipe(fitted, size[::-1])
        points = np.stack(np.meshgrid(np.linspace(-0.5, 339.5, 53), np.linspace(-0.5, 389.5, 61)), axis=-1)
        assert np.abs(small.forward(points) - points).max() > 20
        for found, wanted in (
            (big.forward((points + 0.5) * factor - 0.5), small.forward(points)),
            (big.inverse((points + 0.5) * factor - 0.5).points, small.inverse(points).points),
        ):
            assert np.abs((found + 0.5) / factor - 0.5 - wanted).max() < 1e-6
        assert fitted.size == size
        assert [s.radius for s in fitted.strokes] == [s.radius * factor for s in recipe.strokes]

    def test_within_half_a_pixel_of_the_same_proportions(self) -> None:
        assert CHEEKS.fitted((170, 195)).strokes[0].radius == 10
        assert CHEEKS.fitted((101, 116)).strokes[0].radius == pytest.approx(20 * 101 / 340, rel=2e-3)
        assert refusal(lambda: CHEEKS.fitted((101, 118))).startswith(
            "the recipe was made for 340 x 390, and this is 101 x 118, of other proportions: say how it fits"
        )

    def test_how(self) -> None:
        assert CHEEKS.fitted((680, 390), "pixels") == replace(CHEEKS, size=(680, 390))
        stretched = replace(CHEEKS, border=30).fitted((680, 390), "stretch")
        assert stretched.strokes[0].at == (300.5, 180.0)
        assert stretched.strokes[0].by == (80.0, 5.0)
        assert stretched.strokes[0].radius == pytest.approx(20 * math.sqrt(2))
        assert stretched.border == (60.0, 30.0)
        inside = replace(CHEEKS, border=30).fitted((1000, 780), "inside")
        assert inside.strokes[0] == Stroke(at=(300.5 + 160, 360.5), by=(80, 10), radius=40)
        assert inside.border == 60
        assert refusal(lambda: CHEEKS.fitted((680, 390), "crop")).startswith('fit must be "pixels" or ')  # type: ignore[arg-type]

    def test_time(self) -> None:
        clip = Recipe(size=(64, 48, 20), strokes=(Stroke.grab((30, 20, 9), to=(40, 20, 9), radius=8),))
        fitted = clip.fitted((128, 96, 20), time=True)
        assert fitted.strokes[0] == Stroke(at=(60.5, 40.5, 9), by=(20, 0, 0), radius=16)
        assert "fit='stretch' scales time too" in refusal(lambda: clip.fitted((64, 48, 40), time=True))
        assert "fit='stretch' scales time too" in refusal(lambda: clip.fitted((64, 48, 40), "inside", time=True))
        assert clip.fitted((64, 48, 40), "stretch", time=True).strokes[0].at == (30, 20, 18.5)
        assert "voxels are not scaled" in refusal(lambda: clip.fitted((128, 96, 40)))
        assert clip.fitted((128, 96, 40), "pixels").strokes == clip.strokes

    def test_what_has_no_size_is_taken_as_it_is(self) -> None:
        loose = replace(CHEEKS, size=None)
        assert loose.fitted((999, 100)).strokes == loose.strokes
        assert refusal(lambda: loose.fitted((999, 100), "inside")).startswith("fit needs the size")
        world = Recipe(space="LPS", size=(9, 9, 9), strokes=(grab(at=(1, 2, 3), by=(1, 0, 0)),))
        assert world.fitted((5, 6, 7)).strokes == world.strokes
        assert "LPS millimetres" in refusal(lambda: world.fitted((5, 6, 7), "pixels"))

    def test_a_deformation_knows_its_size_and_refuses_another(self) -> None:
        d = Deformation((390, 340)).grab((150, 180), by=(9, 0), radius=20)
        assert d.recipe.size == (340, 390)
        assert Deformation.from_recipe(d.recipe, d.shape) == d
        assert "made for 340 x 390, and the shape is of 680 x 780" in refusal(
            lambda: Deformation.from_recipe(d.recipe, (780, 680))
        )


LATER = Recipe(
    border=None,
    strokes=(
        Stroke.grab((200, 200), to=(260, 200), radius=50),
        Stroke.grab((260, 200), to=(260, 330), radius=40),
        Stroke.grab((260, 320), to=(340, 320), radius=40),
    ),
)


class TestAmount:
    def test_in_full_it_is_what_it_was_bit_for_bit(self) -> None:
        steps = Deformation((512, 512), border=None)
        for stroke in LATER.strokes:
            steps = steps.add(stroke)
        full = Deformation.from_recipe(replace(LATER, amount=1.0), (512, 512))
        assert full == steps
        assert full.space.table.tobytes() == steps.space.table.tobytes()

    @pytest.mark.parametrize("part", [0.3, 0.7])
    def test_later_pivots_follow_the_material(self, part: float) -> None:
        d = Deformation.from_recipe(replace(LATER, amount=part), (512, 512))
        first, second, _ = d.strokes
        assert first == Stroke(at=(200, 200), by=(60 * part, 0), radius=50)
        # The second takes hold of what the first one held, which is at 200 + 60 part now.
        np.testing.assert_allclose(second.at, (200 + 60 * part, 200), atol=1e-6)
        assert second.by == (0, 130 * part)
        report = d.report()
        assert report.folds == 0
        assert report.margin > 0
        points = np.random.default_rng(1).uniform(0, 512, (2000, 2))
        assert np.linalg.det(d.jacobian(points)).min() > 0
        assert Deformation.from_recipe(d.recipe, d.shape) == d

    def test_a_point_of_the_material_goes_a_part_of_its_way(self) -> None:
        full, less, none = (
            Deformation.from_recipe(replace(LATER, amount=part), (512, 512)) for part in (1.0, 0.3, 0.0)
        )
        np.testing.assert_allclose(full.forward((200, 200))[:2], (340, 320), atol=25)
        np.testing.assert_allclose(less.forward((200, 200)), (200 + 0.3 * 60 + 0.3 * 80, 200 + 0.3 * 130), atol=8)
        points = np.random.default_rng(1).uniform(0, 512, (100, 2))
        np.testing.assert_array_equal(none.forward(points), points)

    def test_the_strength_of_a_stroke_carries_later_ones(self) -> None:
        strokes = (replace(LATER.strokes[0], strength=0.5), *LATER.strokes[1:])
        d = Deformation.from_recipe(replace(LATER, strokes=strokes), (512, 512))
        assert d.strokes[0].by == (30, 0)
        np.testing.assert_allclose(d.strokes[1].at, (230, 200), atol=1e-6)
        assert d.strokes[1].by == LATER.strokes[1].by
        last = replace(LATER, strokes=(*LATER.strokes[:2], replace(LATER.strokes[2], strength=0.5)))
        known = Deformation.from_recipe(last, (512, 512)).strokes
        assert known[:2] == LATER.strokes[:2]
        assert (known[2].at, known[2].by) == (LATER.strokes[2].at, (40, 0))
        half = replace(LATER.strokes[0], strength=0.5)
        assert Deformation((512, 512), border=None).add(half).strokes[0].by == (30, 0)

    def test_hidden_strokes_carry_nothing(self) -> None:
        hidden = (replace(LATER.strokes[0], hidden=True), *LATER.strokes[1:])
        d = Deformation.from_recipe(replace(LATER, strokes=hidden, amount=0.5), (512, 512))
        assert d.strokes[0].at == (260, 200)

    def test_errors_name_the_stroke(self) -> None:
        folding = replace(LATER, on_fold="error", amount=0.3)
        assert Deformation.from_recipe(replace(folding, strokes=LATER.strokes[1:2]), (512, 512)).strokes
        message = refusal(lambda: Deformation.from_recipe(folding, (512, 512)))
        assert message.startswith("stroke 2 of 3: ")  # in full it folds, and the third is placed on that
