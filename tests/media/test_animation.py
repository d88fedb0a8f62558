"""Animated WebP and PNG that clips become, as Pillow reads them."""

import itertools
import struct
import warnings
from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image, ImageCms

import supple
from supple.errors import SuppleError
from supple.files import warp_file
from supple.files.options import ClipOptions
from supple.media.base import ClipWarning
from supple.media.image import DepthWarning, ImageWarning, PageWarning, write
from supple.media.medium import opened
from tests import clips

NONE = supple.Recipe()
DRAG = supple.Recipe(strokes=[supple.Stroke.grab((30, 24), by=(6, 3), radius=8)])
TIMES = [70, 130, 40, 200]


def frames_of(path):
    """The frames of a file, as RGBA or in its own mode, and what Pillow says of it."""
    with Image.open(path) as image:
        made, times = [], []
        for k in range(image.n_frames):
            image.seek(k)
            image.load()
            times.append(image.info.get("duration"))
            made.append(np.array(image))
        return made, times, image.info, image.mode


def drawn(count=4, alpha=True, size=(60, 48)):
    """Frames of which a square moves over a plain ground; with opacity, parts are half seen, and parts not at all."""
    width, height = size
    frames = np.full((count, height, width, 4), (200, 120, 40, 255), np.uint8)
    for k, frame in enumerate(frames):
        frame[10 + k : 21 + k, 5 + 3 * k : 16 + 3 * k] = (20 * k, 255 - 9 * k, 90, 128 if alpha else 255)
        frame[:5, 50:] = (1, 2, 3, 0 if alpha else 255)
    return frames if alpha else frames[..., :3]


def saved(path, frames, *, plays=3, times=TIMES, **options):
    first, *others = map(Image.fromarray, frames)
    more = {"lossless": True, "exact": True} if path.suffix == ".webp" else {}
    first.save(path, save_all=True, append_images=others, duration=times, loop=plays, **more, **options)
    return path


@pytest.mark.parametrize("alpha", [True, False])
@pytest.mark.parametrize("plays", [0, 3])
@pytest.mark.parametrize(("source", "target"), [(a, b) for a in (".webp", ".png") for b in (".webp", ".apng")])
def test_frames_times_and_repetitions_come_through(tmp_path, source, target, plays, alpha):
    frames = drawn(alpha=alpha)
    path = saved(tmp_path / f"in{source}", frames, plays=plays)
    warp_file(path, tmp_path / f"out{target}", NONE, lossless=target == ".webp")
    found, times, known, mode = frames_of(tmp_path / f"out{target}")
    seen = np.stack(found)
    if source == ".webp" and not alpha:  # whose encoder marks what does not change as transparent
        seen = seen[..., :3]
    if alpha and ".webp" in (source, target):  # decoders of animations drop colours that are not seen
        seen, frames = (np.where(each[..., 3:] > 0, each, 0) for each in (seen, frames))
    np.testing.assert_array_equal(seen, frames)
    assert (times, known["loop"]) == (TIMES, plays)
    assert source == ".webp" or mode == ("RGBA" if alpha else "RGB")


@pytest.mark.parametrize("target", [".webp", ".apng"])
def test_only_what_changes_is_stored_again(tmp_path, target):
    ground = np.random.default_rng(1).integers(0, 256, (48, 60, 3), np.uint8)
    frames = np.repeat(ground[None], 4, axis=0)
    for k in range(1, 4):
        frames[k, 9 + k : 15 + k, 7 + 5 * k : 16 + 5 * k] = 40 * k
    saved(tmp_path / "in.png", frames)
    warp_file(tmp_path / "in.png", tmp_path / f"out{target}", NONE, lossless=target == ".webp")
    np.testing.assert_array_equal(np.stack(frames_of(tmp_path / f"out{target}")[0]), frames)
    assert (tmp_path / f"out{target}").stat().st_size < 1.2 * ground.nbytes


def test_an_opaque_animation_stays_opaque(tmp_path):
    saved(tmp_path / "in.png", drawn(alpha=False))
    warp_file(tmp_path / "in.png", tmp_path / "a.webp", NONE, lossless=True)
    warp_file(tmp_path / "a.webp", tmp_path / "b.apng", NONE)
    found, _, _, mode = frames_of(tmp_path / "b.apng")
    assert mode == "RGB"
    np.testing.assert_array_equal(np.stack(found), drawn(alpha=False))


@pytest.mark.parametrize("target", [".webp", ".apng"])
def test_a_gif_becomes_one(tmp_path, target):
    frames = drawn(alpha=False)
    saved(tmp_path / "in.gif", frames, times=[70, 130, 40, 200], plays=2)  # which repeats twice, and plays three times
    made = warp_file(tmp_path / "in.gif", tmp_path / f"out{target}", DRAG, lossless=target == ".webp")
    found, times, known, _ = frames_of(tmp_path / f"out{target}")
    assert (made.frames, times, known["loop"]) == (4, TIMES, 3)
    with Image.open(tmp_path / "in.gif") as image:
        for k, got in enumerate(found):
            image.seek(k)
            want = supple.Deformation((48, 60)).grab((30, 24), by=(6, 3), radius=8).warp(np.array(image.convert("RGB")))
            assert np.abs(got[..., :3].astype(int) - want).max() <= 1


def test_equal_frames_stay(tmp_path):
    frames = np.repeat(drawn(1), 4, axis=0)
    for k, value in enumerate((1, 2, 3)):
        frames[k, 0, 0] = value  # Pillow joins frames that are alike
    path = saved(tmp_path / "in.png", frames)
    held = supple.Recipe(strokes=DRAG.strokes)
    for target in ("out.apng", "out.webp"):
        warp_file(path, tmp_path / target, held, clip=ClipOptions(), frames=(3, 3))
        assert len(frames_of(tmp_path / target)[0]) == 4


def delays(path):
    """The delays of an APNG, as fractions of a second."""
    data, at, found = path.read_bytes(), 8, []
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        if kind == b"fcTL":
            found.append(Fraction(*struct.unpack_from(">HH", data, at + 8 + 20)))
        at += 12 + size
    return found


@pytest.mark.parametrize("target", [".webp", ".apng"])
def test_times_of_a_film_are_kept(tmp_path, target):
    film = clips.make(tmp_path / "in.mp4", count=30, rate=Fraction(30000, 1001))
    warp_file(film, tmp_path / f"out{target}", DRAG)
    found, times, known, mode = frames_of(tmp_path / f"out{target}")
    assert (len(found), known["loop"], mode) == (30, 0, "RGB")
    if target == ".apng":
        assert delays(tmp_path / "out.apng") == [Fraction(1001, 30000)] * 30
        warp_file(tmp_path / "out.apng", tmp_path / "again.apng", DRAG)
        assert delays(tmp_path / "again.apng") == [Fraction(1001, 30000)] * 30
    else:  # whole milliseconds, whose errors do not add up
        assert set(times) == {33, 34}
        assert sum(times) == round(30 * 1001 / 30)


@pytest.mark.parametrize("target", [".webp", ".apng"])
def test_variable_times_are_kept(tmp_path, target):
    times = [5, 7, 107, 110, 1000, 1001]
    film = clips.make(tmp_path / "in.mkv", "ffv1", "bgra", count=6, times=times, base=Fraction(1, 1000))
    warp_file(film, tmp_path / f"out{target}", NONE)
    found = frames_of(tmp_path / f"out{target}")[1]
    steps = [b - a for a, b in itertools.pairwise(times)]
    assert found[:-1] == steps
    warp_file(tmp_path / f"out{target}", tmp_path / "again.apng", DRAG)  # and read so
    assert [1000 * each for each in delays(tmp_path / "again.apng")][:-1] == steps


def test_ten_bits_become_sixteen(tmp_path):
    film = clips.make(tmp_path / "in.mkv", "ffv1", "gbrp10le", count=3, smooth=False)
    warp_file(film, tmp_path / "out.apng", NONE)
    warp_file(film, tmp_path / "alone-%d.png", NONE)
    with av.open(str(tmp_path / "out.apng")) as found:
        for k, frame in enumerate(found.decode(video=0)):
            with av.open(str(tmp_path / f"alone-{k + 1}.png")) as alone:
                assert frame.format.name == "rgb48be"
                np.testing.assert_array_equal(frame.to_ndarray(), next(alone.decode(video=0)).to_ndarray())
    with pytest.warns(DepthWarning, match="holds 8 bits"):
        warp_file(film, tmp_path / "out.webp", NONE)


def test_a_film_is_upright_and_silent(tmp_path):
    quarter = (0, 65536, 0, -65536, 0, 0, 48 * 65536, 0, 1 << 30)
    film = clips.make(
        tmp_path / "in.mov", count=3, audio="aac", setup=lambda stream: stream.set_display_matrix(quarter)
    )
    with pytest.warns(ClipWarning, match=r"out\.apng gets pictures alone, without the sound of .*in\.mov"):
        warp_file(film, tmp_path / "out.apng", NONE)
    warp_file(film, tmp_path / "alone.png", NONE, frame=1)
    found = frames_of(tmp_path / "out.apng")[0]
    assert found[0].shape == (64, 48, 3)
    np.testing.assert_array_equal(found[1], np.array(Image.open(tmp_path / "alone.png")))


@pytest.mark.parametrize("target", [".webp", ".apng"])
def test_profiles_come_through(tmp_path, target):
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    icc = icc[:16] + b"RGB " + icc[20:]
    path = saved(tmp_path / "in.webp", drawn(alpha=False), icc_profile=icc)
    warp_file(path, tmp_path / f"out{target}", DRAG)
    assert frames_of(tmp_path / f"out{target}")[2]["icc_profile"] == icc


def test_numbered_pictures_become_one_at_a_rate(tmp_path):
    for k, frame in enumerate(drawn()):
        write(tmp_path / f"f{k}.png", frame)
    warp_file(tmp_path / "f%d.png", tmp_path / "out.webp", DRAG, clip=ClipOptions(rate=50))
    assert frames_of(tmp_path / "out.webp")[1] == [20] * 4


def test_quality_is_of_each_frame(tmp_path):
    film = clips.make(tmp_path / "in.mkv", "ffv1", "bgra", count=2, smooth=False)
    sizes = []
    for quality in (20, 90, None):
        warp_file(film, tmp_path / "out.webp", NONE, quality=quality, force=True)
        sizes.append((tmp_path / "out.webp").stat().st_size)
    assert sizes[0] < sizes[1] == sizes[2]
    with pytest.warns(ImageWarning, match="quality 20 changes nothing in PNG"):
        warp_file(film, tmp_path / "out.apng", NONE, quality=20)


@pytest.mark.parametrize(
    ("source", "target", "kind"),
    [
        ("a.webp", "b.webp", "clip"),
        ("a.webp", "b.apng", "clip"),
        ("a.webp", "b.png", "picture"),
        ("a.png", "b.png", "clip"),
        ("a.png", "b.webp", "clip"),
        ("a.gif", "b.webp", "clip"),
        ("a.gif", "b.png", "picture"),
        ("one.gif", "b.webp", "picture"),
        ("one.png", "b.png", "picture"),
        ("one.png", "b.apng", "picture"),
        ("one.webp", "b.webp", "picture"),
    ],
)
def test_what_is_animated_stays_so(tmp_path, source, target, kind):
    saved(tmp_path / source, drawn(4 if source[0] == "a" else 1, alpha=False), times=TIMES if source[0] == "a" else 70)
    assert opened(tmp_path / source, tmp_path / target).kind == kind
    with warnings.catch_warnings(action="ignore", category=PageWarning):
        warp_file(tmp_path / source, tmp_path / target, DRAG)
    assert len(frames_of(tmp_path / target)[0]) == (4 if kind == "clip" else 1)


def test_what_it_cannot_be(tmp_path):
    film = clips.make(tmp_path / "in.mp4", count=2)
    with pytest.raises(
        SuppleError, match=r"out\.png is one picture, and a clip is many: name an animated one \(\.webp"
    ):
        warp_file(film, tmp_path / "out.png", DRAG)
    with pytest.raises(SuppleError, match=r"crf is for videos, and out\.webp is pictures|crf"):
        warp_file(film, tmp_path / "out.webp", DRAG, clip=ClipOptions(crf=20))
    (tmp_path / "out.apng").write_bytes(b"mine")
    with pytest.raises(SuppleError, match="exists already"):
        warp_file(film, tmp_path / "out.apng", DRAG)
    wide = clips.make(tmp_path / "wide.mkv", "ffv1", "bgra", count=2, size=(16400, 16))
    with pytest.raises(SuppleError, match=r"cannot write out\.webp|WebP ends at 16383"):
        warp_file(wide, tmp_path / "out.webp", NONE)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["in.mp4", "out.apng", "wide.mkv"]
