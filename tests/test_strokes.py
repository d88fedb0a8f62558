"""Strokes and recipes: values, JSON, refusals, and the packed table against exact arithmetic."""

from __future__ import annotations

import copy
import json
import math
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from supple.deformation import Deformation
from supple.errors import OutsideWarning, SuppleError
from supple.strokes import STROKE_DTYPE, Recipe, Stroke, pack

HUGE = pytest.param(10**5000, id="huge")  # too long for Python to spell
RATIOS = [0.4, 0.5, 0.25, 0.0, -1.0, -1e9, -1e308, -math.inf]
Floats = npt.NDArray[np.float64]


def displacement_reference(row: np.void, points: npt.ArrayLike) -> Floats:
    """K at points of three coordinates, as the table defines it."""
    d = np.asarray(points, np.float64) - row["pivot"]
    along = (d @ row["force"])[..., None] * d
    total: Floats = np.zeros_like(d)
    for i in range(int(row["terms"])):
        rho = np.sqrt((d * d).sum(-1, keepdims=True) + row["radius2"][i])
        total += (row["p"][i] / rho + row["q"][i] / rho**3) * row["force"] + row["r"][i] / rho**3 * along
    return total


def kelvinlets(stroke: Stroke, points: Floats) -> Floats:
    """K from the equations as they are printed: kelvinlets, weighted, then normalised."""
    a = 1 / (4 * np.pi)
    b = a / (4 * (1 - stroke.poisson))
    radii = stroke.radius * np.array([1, 1.1, 1.21])
    e1, e2, e3 = radii**2
    weights = {1: [1], 2: [1, -1], 3: [1, -(e3 - e1) / (e3 - e2), (e2 - e1) / (e3 - e2)]}[stroke.scales]
    pivot, f = np.zeros((2, 3))
    pivot[: stroke.ndim], f[: stroke.ndim] = stroke.at, stroke.by

    def unscaled(r: Floats) -> Floats:
        total = np.zeros((*r.shape[:-1], 3, 3))
        for weight, radius in zip(weights, radii, strict=False):
            rho = np.sqrt((r * r).sum(-1) + radius**2)[..., None, None]
            outer = r[..., :, None] * r[..., None, :]
            matrix = ((a - b) / rho + a * radius**2 / (2 * rho**3)) * np.eye(3) + b / rho**3 * outer
            total += weight * matrix
        return total

    result: Floats = unscaled(points - pivot) @ f / unscaled(np.zeros(3))[0, 0]
    return result


def exact_magnitude(row: np.void, distance: int) -> Decimal:
    """|K| at a distance, slantwise to the force, in 60 digits: what rounding is left is the table's."""
    with localcontext() as context:
        context.prec = 60
        slant = [Decimal(3) / 5 * distance, Decimal(4) / 5 * distance, Decimal(0)]
        force = [Decimal(float(x)) for x in row["force"]]
        dot = sum((x * y for x, y in zip(slant, force, strict=True)), Decimal(0))
        total = [Decimal(0)] * 3
        for i in range(int(row["terms"])):
            radius2, p, q, r = (Decimal(float(row[name][i])) for name in ("radius2", "p", "q", "r"))
            rho = (Decimal(distance) ** 2 + radius2).sqrt()
            total = [
                t + (p / rho + q / rho**3) * f + r / rho**3 * dot * x
                for t, f, x in zip(total, force, slant, strict=True)
            ]
        return sum((t * t for t in total), Decimal(0)).sqrt()


def grab(**changes: Any) -> Stroke:
    return Stroke(**{"at": (256, 256), "by": (0, 90), "radius": 100, **changes})


def refusal(call: Callable[[], object]) -> str:
    """The message with which a call is refused, checked to be one plain sentence."""
    with pytest.raises(SuppleError) as caught:
        call()
    message = str(caught.value)
    assert message.isprintable()
    assert 10 < len(message) < 300
    return message


coordinates = st.floats(-1e30, 1e30)
ratios = st.floats(max_value=0.5, allow_nan=False, allow_infinity=True)


@st.composite
def recipes(draw: st.DrawFn) -> Recipe:
    ndim = draw(st.sampled_from([2, 3]))
    points = st.tuples(*[coordinates] * ndim)
    strokes = st.builds(
        Stroke,
        at=points,
        by=points,
        radius=st.floats(1e-30, 1e30),
        poisson=st.none() | ratios,
        scales=st.sampled_from([1, 2, 3]),
        reach=st.none() | st.floats(1, 1e30),
        hidden=st.booleans(),
        name=st.none() | st.text(),
        strength=st.floats(0, 1),
    )
    space: Any = draw(st.sampled_from([None, "pixels", "LPS", "RAS"] if ndim == 3 else [None, "pixels"]))
    return Recipe(
        border=draw(st.none() | st.just("auto") | st.floats(1e-30, 1e30)),
        size=draw(st.none() | st.tuples(*[st.integers(1, 2**31 - 1)] * ndim)),
        space=space,
        amount=draw(st.floats(0, 1)),
        border_profile=draw(st.sampled_from(["quartic", "sine"])),
        on_fold=draw(st.sampled_from(["damp", "flow", "error"])),
        strokes=tuple(draw(st.lists(strokes, max_size=5))),
    )


class TestStroke:
    def test_defaults(self) -> None:
        stroke = grab()
        assert (stroke.poisson, stroke.scales, stroke.brush, stroke.ndim) == (None, 1, "grab", 2)
        assert (stroke.reach, stroke.material()) == (4, 0.4)
        assert grab(at=(1, 2, 3), by=(1, 2, 3)).ndim == 3

    def test_is_a_value(self) -> None:
        stroke = grab(at=np.array([1, 2]), by=[3, np.float32(4)], radius=np.int64(5), scales=np.uint8(2))
        assert stroke == Stroke(at=(1.0, 2.0), by=(3.0, 4.0), radius=5.0, scales=2)
        assert len({stroke, replace(stroke), copy.deepcopy(stroke), pickle.loads(pickle.dumps(stroke))}) == 1
        assert [type(x) for x in (*stroke.at, *stroke.by, stroke.radius)] == [float] * 5
        assert type(stroke.scales) is int
        with pytest.raises(FrozenInstanceError):
            stroke.radius = 3.0  # type: ignore[misc]
        with pytest.raises(TypeError):
            Stroke((1, 2), (3, 4), 5)  # type: ignore[call-arg]

    def test_grab_to_and_by(self) -> None:
        expected = Stroke(at=(256, 256), by=(0, 90), radius=100)
        assert Stroke.grab((256, 256), to=(256, 346), radius=100) == expected
        assert Stroke.grab([256, 256], by=np.array([0, 90]), radius=100) == expected
        solid = Stroke.grab((1, 2, 3), to=(3, 2, 1), radius=4, poisson=-math.inf, scales=3, reach=5)
        assert solid == Stroke(at=(1, 2, 3), by=(2, 0, -2), radius=4, poisson=-math.inf, scales=3, reach=5.0)
        assert type(solid.reach) is float

    def test_grab_takes_one_of_to_and_by(self) -> None:
        both = refusal(lambda: Stroke.grab((1, 2), to=(1, 2), by=(1, 2), radius=1))
        assert both == "a grab takes one of to and by, found both"
        assert refusal(lambda: Stroke.grab((1, 2), radius=1)).endswith("found neither")

    @pytest.mark.parametrize(
        "bad", [(1,), (1, 2, 3, 4), (), 5, None, "12", b"12", {1: 2, 3: 4}, np.eye(2), np.array(1)]
    )
    def test_refuses_points(self, bad: Any) -> None:
        assert refusal(lambda: grab(at=bad)).startswith("at must be 2 or 3 numbers, x first, found ")
        assert refusal(lambda: grab(by=bad)).startswith("by must be 2 numbers, x first, found ")
        assert refusal(lambda: Stroke.grab(bad, by=(1, 2), radius=1)).startswith("at must be ")
        if bad is not None:
            assert refusal(lambda: Stroke.grab((1, 2), to=bad, radius=1)).startswith("to must be ")

    def test_refuses_points_of_unlike_lengths(self) -> None:
        assert refusal(lambda: grab(by=(1, 2, 3))) == "by must be 2 numbers, x first, found (1, 2, 3)"
        assert refusal(lambda: grab(at=(1, 2, 3))) == "by must be 3 numbers, x first, found (0, 90)"
        assert refusal(lambda: Stroke.grab((1, 2, 3), to=(1, 2), radius=1)).startswith("to must be 3 numbers")

    @pytest.mark.parametrize(
        "bad", [math.nan, math.inf, -math.inf, True, np.True_, "1", None, 1j, [1], 1.1e30, 10**400, HUGE]
    )
    def test_refuses_coordinates(self, bad: Any) -> None:
        assert refusal(lambda: grab(at=(1, bad))).startswith("at[1] must be a number from -1e+30 to 1e+30, found ")
        assert refusal(lambda: grab(by=(bad, 1))).startswith("by[0] must be ")

    @pytest.mark.parametrize(
        "bad",
        [
            0,
            -0.0,
            -1,
            math.nan,
            math.inf,
            True,
            "100",
            None,
            1e-31,
            1e31,
            10**400,
            Fraction(10**400),
            [1],
            np.eye(1),
        ],
    )
    def test_refuses_radii(self, bad: Any) -> None:
        assert refusal(lambda: grab(radius=bad)).startswith("radius must be a number above 0 (from ")

    @pytest.mark.parametrize("bad", [0.6, math.nextafter(0.5, 1), math.nan, math.inf, True, "-inf", -(10**400)])
    def test_refuses_poisson_ratios(self, bad: Any) -> None:
        assert refusal(lambda: grab(poisson=bad)).startswith("poisson must be a number up to 0.5, or -inf, found ")

    @pytest.mark.parametrize("bad", [0, 4, -1, 1.0, True, "1", None, math.nan, [1], HUGE, np.array([1, 2])])
    def test_refuses_scales(self, bad: Any) -> None:
        assert refusal(lambda: grab(scales=bad)).startswith("scales must be 1, 2 or 3, found ")

    @pytest.mark.parametrize("bad", [0, -4, 0.999, math.nan, math.inf, 1.1e30, True, "4", "none", [4], 10**400, HUGE])
    def test_refuses_reaches(self, bad: Any) -> None:
        wanted = "reach must be a number of radii from 1 to 1e+30, or None for no limit, found "
        assert refusal(lambda: grab(reach=bad)).startswith(wanted)

    @pytest.mark.parametrize("bad", [0, 1, None, "true", np.True_, []])
    def test_refuses_what_is_neither_hidden_nor_not(self, bad: Any) -> None:
        assert refusal(lambda: grab(hidden=bad)).startswith("hidden must be true or false, found ")

    @pytest.mark.parametrize("bad", ["twist", "", "Grab", None, 1, ["grab"]])
    def test_refuses_brushes(self, bad: Any) -> None:
        assert refusal(lambda: grab(brush=bad)).startswith('brush must be "grab", found ')


class TestRecipe:
    def test_defaults(self) -> None:
        assert Recipe() == Recipe(border="auto", border_profile="quartic", on_fold="flow", strokes=())
        assert Recipe() != Recipe(border_profile="sine")
        assert Recipe(strokes=[grab()]).strokes == (grab(),)  # type: ignore[arg-type]
        assert Recipe(strokes=(s for s in [grab()])).strokes == (grab(),)  # type: ignore[arg-type]
        assert hash(Recipe(border=None)) == hash(Recipe(border=None))

    @pytest.mark.parametrize("bad", [0, -1, math.nan, math.inf, "none", True, [50]])
    def test_refuses_borders(self, bad: Any) -> None:
        assert refusal(lambda: Recipe(border=bad)).startswith("border must be ")

    @pytest.mark.parametrize("bad", ["cubic", None, 1, "SINE", ["sine"]])
    def test_refuses_border_profiles(self, bad: Any) -> None:
        message = refusal(lambda: Recipe(border_profile=bad))
        assert message.startswith('border_profile must be "quartic" or "sine", found ')

    @pytest.mark.parametrize("bad", ["stop", None, 1, "DAMP", ["damp"]])
    def test_refuses_fold_policies(self, bad: Any) -> None:
        assert refusal(lambda: Recipe(on_fold=bad)).startswith('on_fold must be "damp" or "flow" or "error", found ')

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
            '  "supple": 2,\n'
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
            "supple": 2, "border": None, "border_profile": "quartic", "on_fold": "flow", "amount": 1, "strokes": [],
        }  # fmt: skip

    @settings(deadline=None)
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
        assert json.loads(text)["supple"] == 2
        assert Recipe.from_json(text) == recipe

    def test_version_1_has_no_newer_keys(self) -> None:
        old = f'{{"supple": 1, "border_profile": "sine", "strokes": [{GRAB}]}}'
        hint = 'it is of version 2 ("supple": 2)'
        assert read_refusal(old) == f"unknown key 'border_profile' in the recipe: {hint}"
        old = f'{{"supple": 1, "strokes": [{GRAB[:-1]}, "reach": 4}}]}}'
        assert read_refusal(old) == f"unknown key 'reach' in strokes[0]: {hint}"

    def test_what_may_be_left_out(self) -> None:
        text = '{"strokes": [{"radius": 100, "by": [0, 90], "at": [256.0, 256], "brush": "grab"}], "supple": 2}'
        assert Recipe.from_json(text) == Recipe(strokes=(grab(),))
        assert Recipe.from_json('{"supple": 1, "border": null, "strokes": []}').border is None

    @pytest.mark.parametrize("key", ["brush", "at", "by", "radius"])
    def test_missing_keys_of_strokes(self, key: str) -> None:
        entry = json.loads(GRAB)
        del entry[key]
        assert read_refusal(with_stroke(json.dumps(entry))) == f'the key "{key}" is missing in strokes[1]'

    def test_missing_keys(self) -> None:
        assert read_refusal('{"supple": 1}') == 'the key "strokes" is missing in the recipe'
        assert read_refusal('{"strokes": []}').startswith('the key "supple", a recipe\'s version (2), is missing')
        assert read_refusal("{}").endswith("is missing in {}")

    @pytest.mark.parametrize("version", ["3", "0", "-1", "1.0", "true", "null", '"1"', "[1]", "9" * 5000])
    def test_other_versions(self, version: str) -> None:
        message = read_refusal(f'{{"supple": {version}, "new": 1, "strokes": []}}')
        assert message.startswith('"supple" must be 1 or 2 (the versions that this release reads), found ')

    @pytest.mark.parametrize(
        ("key", "hint"),
        [("radus", '"radius"'), ("Poisson", '"poisson"'), ("scale", '"scales"'),
         ("", "known are at, by, radius"), ("zzzz", "known are"), ("line\\nbreak", "known are"),
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
            *[("brush", v) for v in ('"twist"', "1", "null", "[]", '"' + "x" * 10_000 + '"')],
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

    def test_mixed_dimensions(self) -> None:
        solid = '{"brush": "grab", "at": [1, 2, 3], "by": [1, 2, 3], "radius": 1}'
        assert read_refusal(with_stroke(solid)).startswith("strokes[1].at must be a point of 2 numbers")

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

    @pytest.mark.parametrize("text", ["[]", "1", "null", '"supple"', "true", "9" * 5000, "[" * 50 + "]" * 50])
    def test_not_an_object(self, text: str) -> None:
        assert read_refusal(text).startswith("a recipe must be a JSON object, found ")

    @pytest.mark.parametrize("text", ["[" * 200_000, '{"a":' * 200_000, "[" * 200_000 + "]" * 200_000])
    def test_deep_garbage(self, text: str) -> None:
        assert read_refusal(text) == "a recipe must be JSON: it is nested too deeply"

    @pytest.mark.parametrize("text", [None, 1, b"{}", {"supple": 1}])
    def test_not_text(self, text: Any) -> None:
        assert read_refusal(text).startswith("a recipe must be text in JSON, found ")

    @settings(deadline=None)
    @given(
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
            lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["border", "strokes", "at", "x"]), inner),
        )
    )
    def test_any_other_json(self, data: object) -> None:
        read_refusal(json.dumps(data))
        read_refusal(with_stroke(json.dumps(data)))

    @settings(deadline=None)
    @given(st.text())
    def test_any_other_text(self, text: str) -> None:
        read_refusal(text)

    @settings(deadline=None)
    @given(recipes(), st.data())
    def test_truncated(self, recipe: Recipe, data: st.DataObject) -> None:
        text = recipe.to_json()
        read_refusal(text[: data.draw(st.integers(0, len(text) - 3))])


class TestVersion2:
    """What a recipe of version 2 says besides its strokes."""

    def test_everything_that_matters_is_written(self) -> None:
        stroke = grab(at=(1, 2, 3), by=(4, 5, 6), name="left cheek", strength=0.5)
        recipe = Recipe(strokes=(stroke,), size=(64, 48, 32), space="RAS", amount=0.3)
        assert json.loads(recipe.to_json()) == {
            "supple": 2, "border": "auto", "border_profile": "quartic", "on_fold": "flow", "amount": 0.3,
            "space": "RAS", "size": [64, 48, 32],
            "strokes": [{"brush": "grab", "at": [1, 2, 3], "by": [4, 5, 6], "radius": 100, "scales": 1, "reach": 4,
                         "poisson": None, "strength": 0.5, "name": "left cheek"}],
        }  # fmt: skip

    def test_to_in_the_place_of_by(self) -> None:
        entry = GRAB.replace('"by": [0, 90]', '"to": [256, 346]')
        assert Recipe.from_json(with_stroke(entry)).strokes[1] == grab(poisson=0.4)
        both = '"to": [256, 346], "by": [0, 90]'
        assert read_refusal(with_stroke(GRAB.replace('"by": [0, 90]', both))) == (
            'strokes[1] takes one of "to" and "by", found both'
        )
        assert read_refusal(with_stroke(entry.replace("346]", "346, 1]"))).startswith(
            "strokes[1]: to must be 2 numbers"
        )
        assert read_refusal(f'{{"supple": 1, "strokes": [{entry}]}}').startswith(
            "unknown key 'to' in strokes[0]: it is"
        )

    @pytest.mark.parametrize(
        ("name", "value"),
        [*[("strength", v) for v in ("1.01", "-0.1", "true", "null", '"1"')],
         *[("name", v) for v in ("1", "true", "[]")]],
    )  # fmt: skip
    def test_wrong_values_of_strokes(self, name: str, value: str) -> None:
        assert read_refusal(with_field(name, value)).startswith(f"strokes[1]: {name} must be ")

    @pytest.mark.parametrize(
        ("name", "value", "message"),
        [
            ("amount", "1.5", "amount must be a number from 0 to 1, found 1.5"),
            ("amount", "true", "amount must be a number from 0 to 1, found True"),
            ("space", '"mm"', 'space must be "pixels" or "LPS" or "RAS", found '),
            ("space", '"RAS"', 'space must be "pixels" where points have 2 numbers, found '),
            ("size", "[640]", "size must be 2 numbers of samples, x first, found [640]"),
            ("size", "[640, 480, 9]", "size must be 2 numbers of samples"),
            ("size", "[640, 0]", "size[1] must be a whole number from 1 to "),
            ("size", "[640, 480.5]", "size[1] must be a whole number from 1 to "),
        ],
    )
    def test_wrong_values(self, name: str, value: str, message: str) -> None:
        assert read_refusal(f'{{"supple": 2, "{name}": {value}, "strokes": [{GRAB}]}}').startswith(message)
        old = f'{{"supple": 1, "{name}": {value}, "strokes": [{GRAB}]}}'
        assert read_refusal(old).endswith('in the recipe: it is of version 2 ("supple": 2)')

    def test_version_1_is_what_it_was(self) -> None:
        recipe = Recipe.from_json(f'{{"supple": 1, "strokes": [{GRAB}]}}')
        stroke = grab(poisson=0.4, reach=None)
        assert recipe == Recipe(border=50, border_profile="sine", on_fold="damp", strokes=(stroke,))
        assert (recipe.size, recipe.space, recipe.amount) == (None, None, 1.0)


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
        assert full._table.tobytes() == steps._table.tobytes()

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


class TestPack:
    def test_layout(self) -> None:
        assert STROKE_DTYPE.isalignedstruct
        assert STROKE_DTYPE.itemsize == 20 * 8
        assert STROKE_DTYPE.names == ("pivot", "force", "radius2", "p", "q", "r", "terms", "reach")
        table = pack([grab(), grab()], (1, 1))
        assert table.dtype == STROKE_DTYPE
        assert table.shape == (2,)
        assert table.flags.c_contiguous
        assert pack([], (1, 1)).shape == (0,)

    def test_units(self) -> None:
        image = pack([grab(at=(3, 5), by=(7, 11))], (2, 10))[0]
        np.testing.assert_array_equal(image["pivot"], [6, 50, 0])
        np.testing.assert_array_equal(image["force"], [14, 110, 0])
        assert image["radius2"][0] == 100.0**2
        volume = pack((s for s in [grab(at=(3, 5, 7), by=(-1, 0, 1))]), (1, 2, 0.5))[0]
        np.testing.assert_array_equal(volume["pivot"], [3, 10, 3.5])
        np.testing.assert_array_equal(volume["force"], [-1, 0, 0.5])

    def test_the_reach_is_in_physical_units(self) -> None:
        table = pack([grab(reach=None), grab(), grab(radius=7, reach=1)], (2, 10))
        assert table["reach"].tolist() == [math.inf, 400.0, 7.0]

    @pytest.mark.parametrize("scales", [1, 2, 3])
    def test_unused_terms(self, scales: int) -> None:
        row = pack([grab(scales=scales)], (1, 1))[0]
        assert row["terms"] == scales
        np.testing.assert_array_equal(row["radius2"][scales:], 100.0**2)
        for name in "pqr":
            assert not row[name][scales:].any()
            assert row[name][:scales].all()

    def test_the_single_grab_as_printed(self) -> None:
        row = pack([grab(poisson=0.4)], (1, 1))[0]
        a = 1 / (4 * math.pi)
        b = a / (4 * 0.6)
        scaled = 100 * 2 / (3 * a - 2 * b)
        np.testing.assert_allclose(row["p"][0], scaled * (a - b), rtol=1e-15)
        np.testing.assert_allclose(row["q"][0], scaled * a * 100**2 / 2, rtol=1e-15)
        np.testing.assert_allclose(row["r"][0], scaled * b, rtol=1e-15)

    @pytest.mark.parametrize("scales", [1, 2, 3])
    @pytest.mark.parametrize("poisson", RATIOS)
    @pytest.mark.parametrize("radius", [1e-30, 1e-3, 0.7, 100, 1e30])
    def test_the_pivot_moves_by_the_force(self, scales: int, poisson: float, radius: float) -> None:
        stroke = grab(at=(1, -2, 3), by=(4, 5, -6), radius=radius, poisson=poisson, scales=scales)
        row = pack([stroke], (1, 2, 3))[0]
        moved = displacement_reference(row, row["pivot"])
        np.testing.assert_allclose(moved, row["force"], rtol=(2e-15, 2e-14, 2e-13)[scales - 1])

    @pytest.mark.parametrize("scales", [1, 2, 3])
    @pytest.mark.parametrize("poisson", [0.4, 0.5, 0.0, -1e9, -math.inf])
    def test_the_equations(self, scales: int, poisson: float) -> None:
        stroke = grab(at=(1, -2, 3), by=(4, 5, -6), radius=10, poisson=poisson, scales=scales)
        points = np.random.default_rng(5).normal(0, 30, (500, 3))
        ours = displacement_reference(pack([stroke], (1, 1, 1))[0], points)
        np.testing.assert_allclose(ours, kelvinlets(stroke, points), rtol=1e-9, atol=1e-12)

    @pytest.mark.parametrize("poisson", RATIOS)
    @pytest.mark.parametrize("scales", [1, 2, 3])
    def test_decay(self, scales: int, poisson: float) -> None:
        row = pack([grab(at=(0, 0), by=(1, 0.3), radius=0.7, poisson=poisson, scales=scales)], (1, 1))[0]
        ratio = exact_magnitude(row, 700) / exact_magnitude(row, 1400)
        # Without b, two scales cancel as much as three do with it.
        expected = 32 if scales == 3 or (scales == 2 and poisson < -1e300) else (2, 8)[scales - 1]
        if (scales, poisson) == (2, -1e9):
            assert 8 < ratio < 32
        else:
            assert float(ratio) == pytest.approx(expected, rel=1e-4)

    @settings(deadline=None)
    @given(st.floats(1e-30, 1e30), ratios, st.sampled_from([2, 3]))
    def test_far_fields_cancel_to_the_last_bit(self, radius: float, poisson: float, scales: int) -> None:
        row = pack([grab(radius=radius, poisson=poisson, scales=scales)], (1, 1))[0]
        assert sum(Fraction(float(x)) for x in row["p"]) == 0
        assert sum(Fraction(float(x)) for x in row["r"]) == 0

    @settings(deadline=None)
    @given(recipes())
    def test_anything_allowed_is_finite(self, recipe: Recipe) -> None:
        ndim = recipe.strokes[0].ndim if recipe.strokes else 2
        for spacing in ((1e-30,) * ndim, (1e30,) * ndim):
            table = pack(recipe.strokes, spacing)
            for name in set(STROKE_DTYPE.names or ()) - {"reach"}:
                assert np.isfinite(table[name]).all()
            assert (table["radius2"] > 0).all()

    def test_refuses_strokes_of_another_dimension(self) -> None:
        assert refusal(lambda: pack([grab()], (1, 1, 1))) == (
            "strokes[0].at must be a point of 3 numbers, as the medium has 3 axes, found (256.0, 256.0)"
        )


def test_a_stroke_outside_is_judged_by_its_reach_in_physical_units() -> None:
    def at(x: float, reach: float | None = 4.0, to: float = 1.0) -> Recipe:
        stroke = Stroke(at=(x, 5.0), by=(to, 0.0), radius=3.0, reach=reach)
        return Recipe(strokes=[stroke], border=None)

    def made(recipe: Recipe) -> Deformation:
        return Deformation.from_recipe(recipe, (10, 20), spacing=(2.0, 1.0))

    made(at(-0.5))
    made(at(19.5))
    with pytest.warns(OutsideWarning, match="starts outside the picture, which has 20 x 10 pixels"):
        made(at(-6.4))
    with pytest.raises(SuppleError, match="reaches nothing of it"):
        made(at(-6.6))
    with pytest.warns(OutsideWarning):
        made(at(-600.0, None))
    with pytest.warns(OutsideWarning):
        made(at(-6.6, to=20.0))  # a flow goes on from where it is


def test_what_poissons_ratio_keeps() -> None:
    """At 0.5, short drags keep volumes, without a reach; they never keep areas, and lower ratios keep less."""

    def change(ndim: int, poisson: float, reach: float | None = None) -> float:
        made = Deformation((41,) * ndim, border=None).add(
            Stroke(at=(20.0,) * ndim, by=(1.0,) + (0.0,) * (ndim - 1), radius=10, poisson=poisson, reach=reach)
        )
        points = np.stack(np.meshgrid(*[np.arange(0.0, 41.0, 2.0)] * ndim), axis=-1)
        return float(np.abs(np.linalg.det(made.jacobian(points)) - 1).max())

    assert change(3, 0.5) < 0.002
    assert change(2, 0.5) > 0.01
    assert change(3, 0.5, 4.0) > 0.01
    for ndim in (2, 3):
        assert change(ndim, 0.5) < change(ndim, 0.3) < change(ndim, -1.0)
