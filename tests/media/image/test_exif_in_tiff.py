"""EXIF in TIFF files, which hold it as entries of their own."""

import struct
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from supple.media.image import DepthWarning, MetadataWarning, read, write
from supple.media.image.exif import for_tiff, from_tiff, into_tiff, is_whole
from tests.effort import examples
from tests.media.image.pictures import FORMATS, SOURCES, UPRIGHT, loaded, save, smooth

CODES = {1: "B", 2: "B", 3: "H", 4: "I", 5: "I", 7: "B", 10: "i", 16: "Q"}
DETAILS = {
    33434: (5, (1, 125)),
    34855: (3, (200,)),
    36864: (7, b"0230"),
    36867: (2, b"2019:01:01 00:00:00\0"),
    37380: (10, (-1, 2)),
    37500: (7, b"maker's own " * 20),
    37510: (7, b"ASCII\0\0\0hello"),
    40962: (4, (30,)),
    40963: (4, (20,)),
    40965: {1: (2, b"R98\0"), 2: (7, b"0100")},
}
PLACE = {
    0: (1, b"\2\3\0\0"),
    1: (2, b"N\0"),
    2: (5, (47, 1, 10, 1, 1234, 100)),
    5: (1, b"\0"),
    29: (2, b"2019:01:01\0"),
}
TAGS = {
    270: (2, b"a bent thing\0"),
    271: (2, b"Acme\0"),
    274: (3, (6,)),
    306: (2, b"2020:01:02 03:04:05\0"),
    315: (2, "Zoë\0".encode()),
    33432: (2, b"me\0"),
    34665: DETAILS,
    34853: PLACE,
    40093: (1, "Zoë\0".encode("utf-16-le")),
}


def save_tiff(path, pixels, tags, order="<", big=False):
    """Write a TIFF, of either kind and byte order, with pyvips and what is tested left out of it."""
    width, pointer = (8, "Q") if big else (4, "I")
    data = bytearray(16)

    def put(raw):
        data.extend(bytes(-len(data) % 8) + raw)
        return len(data) - len(raw)

    def folder(tags):
        table = struct.pack(order + ("Q" if big else "H"), len(tags))
        for tag, item in sorted(tags.items()):
            kind, values = (16 if big else 4, [folder(item)]) if isinstance(item, dict) else item
            raw = struct.pack(f"{order}{len(values)}{CODES[kind]}", *values)
            count = len(values) // (2 if kind in (5, 10) else 1)
            inline = raw.ljust(width, b"\0") if len(raw) <= width else struct.pack(order + pointer, put(raw))
            table += struct.pack(f"{order}HH{pointer}", tag, kind, count) + inline
        return put(table + bytes(width))

    (height, across, channels), depth = pixels.shape, pixels.dtype.itemsize * 8
    start = put(pixels.astype(pixels.dtype.newbyteorder(order)).tobytes())
    numbers = {256: across, 257: height, 259: 1, 262: 2, 277: channels, 278: height}
    structure = {tag: (3, [number]) for tag, number in numbers.items()}
    structure |= {258: (3, [depth] * channels), 273: (4, [start]), 279: (4, [pixels.nbytes])}
    first = folder(structure | tags)
    sign = {"<": b"II", ">": b"MM"}[order]
    data[:16] = sign + (
        struct.pack(order + "HHHQ", 43, 8, 0, first) if big else struct.pack(order + "HIQ", 42, first, 0)
    )
    path.write_bytes(data)


def told(path):
    """Read with Pillow what an image's EXIF says, but for how the pixels are stored and where things stand."""
    with Image.open(path) as image:
        exif = image.getexif()
        folders = {name: dict(exif.get_ifd(name)) for name in (34665, 34853, 40965)}
    folders[34665].pop(40965, None)
    texts = {tag: exif[tag] for tag in (*TAGS, 272, 305) if tag in exif and tag not in folders}
    return {"texts": texts, **folders}


def includes(found, wanted):
    """Tell whether all that is wanted is there: libvips adds what it thinks every JPEG should say."""
    return all(found[folder] | tags == found[folder] for folder, tags in wanted.items())


class TestExifInTiff:
    @pytest.fixture
    def wanted(self, tmp_path_factory):
        """What `TAGS` say once the picture is upright."""
        path = tmp_path_factory.mktemp("wanted") / "in.tif"
        save_tiff(path, smooth(20, 30), TAGS)
        found = told(path)
        assert [len(tags) for tags in found.values()] == [7, len(DETAILS) - 1, len(PLACE), 2]
        found["texts"][274] = 1
        found[34665] |= {40962: 20, 40963: 30}
        return found

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    @pytest.mark.parametrize("big", [False, True])
    @pytest.mark.parametrize("order", "<>")
    def test_is_read(self, tmp_path, wanted, order, big, dtype):
        save_tiff(tmp_path / "in.tif", smooth(20, 30, dtype), TAGS, order, big)
        picture = read(tmp_path / "in.tif")
        np.testing.assert_array_equal(picture.pixels, UPRIGHT[6](smooth(20, 30, dtype)))
        with warnings.catch_warnings(action="ignore", category=DepthWarning):
            for suffix in FORMATS:
                write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
                assert includes(told(tmp_path / f"out{suffix}"), wanted)
                write(tmp_path / "back.tif", read(tmp_path / f"out{suffix}"), force=True)
                assert told(tmp_path / "back.tif") == told(tmp_path / f"out{suffix}")
        assert told(tmp_path / "out.tif") == wanted
        again = read(tmp_path / "out.tif")
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        write(tmp_path / "again.tif", again.pixels, like=again)
        assert told(tmp_path / "again.tif") == wanted

    @pytest.mark.parametrize(
        "exif",
        [
            (4, (2**31,)),  # beyond the end
            (4, (1001,)),  # amid the pixels
            (4, (0,)),
            (2, b"no number\0"),
            {**DETAILS, 34853: (4, (8,))},  # a folder where none belongs
            {**DETAILS, 37510: (4, (1,)), 40965: (4, (2**31,))},
        ],
    )
    def test_damage_is_told_and_the_rest_stays(self, tmp_path, exif, wanted):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 274: (3, (1,)), 34665: exif})
        with pytest.warns(MetadataWarning, match=r"in\.tif: a part of its EXIF cannot be carried over$") as caught:
            picture = read(tmp_path / "in.tif")
        assert len(caught) == 1
        np.testing.assert_array_equal(picture.pixels, smooth(20, 30))
        for suffix in FORMATS:
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
            assert includes(told(tmp_path / f"out{suffix}"), {name: wanted[name] for name in ("texts", 34853)})

    def test_folders_in_circles(self, tmp_path):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 34665: (4, (2**31,)), 34853: (4, (2**31,))})
        data = (tmp_path / "in.tif").read_bytes()
        first = data[4:8]
        for tag in (34665, 34853):
            entry = struct.pack("<HHII", tag, 4, 1, 2**31)
            assert data.count(entry) == 1
            data = data.replace(entry, entry[:8] + first)
        (tmp_path / "in.tif").write_bytes(data)
        with pytest.warns(MetadataWarning, match="a part of its EXIF"):
            read(tmp_path / "in.tif")

    @examples(50)
    @given(st.data(), st.sampled_from("<>"), st.booleans())
    def test_any_damage_comes_to_no_harm(self, tmp_path_factory, data, order, big):
        path = tmp_path_factory.getbasetemp() / "hurt.tif"
        save_tiff(path, smooth(2, 3), TAGS, order, big)
        hurt = bytearray(path.read_bytes())
        at = st.integers(0, len(hurt) - 1)
        for place, byte in data.draw(st.lists(st.tuples(at, st.integers(0, 255)), max_size=12)):
            hurt[place] = byte
        path.write_bytes(hurt[: data.draw(st.one_of(st.just(len(hurt)), at))])
        block, _ = from_tiff(path)
        if block is not None:
            assert is_whole(block)
            save(path, smooth(4, 5), bigtiff=big)
            into_tiff(path, for_tiff(block, 5, 4), {})
            assert from_tiff(path)[1]
            np.testing.assert_array_equal(loaded(path)[0], smooth(4, 5))

    @pytest.mark.parametrize("cut", [40, 200, -40])
    def test_a_block_cut_short_is_told(self, tmp_path, cut):
        save_tiff(tmp_path / "in.tif", smooth(20, 30), TAGS)
        picture = read(tmp_path / "in.tif")
        picture._header["exif-data"] = picture._header["exif-data"][:cut]
        with pytest.warns(MetadataWarning, match=r"out\.tif: TIFF cannot take over a part of EXIF$"):
            write(tmp_path / "out.tif", picture.pixels, like=picture)
        again = read(tmp_path / "out.tif")  # without a warning
        np.testing.assert_array_equal(again.pixels, picture.pixels)
        told(tmp_path / "out.tif")

    @pytest.mark.parametrize("suffix", SOURCES)
    def test_what_only_tiff_has_room_for_is_told(self, tmp_path, suffix, wanted):
        large = {**DETAILS, 37500: (7, bytes(70_000))}
        save_tiff(tmp_path / "in.tif", smooth(20, 30), {**TAGS, 34665: large})
        picture = read(tmp_path / "in.tif")
        write(tmp_path / "out.tif", picture.pixels, like=picture)
        assert told(tmp_path / "out.tif")[34665][37500] == bytes(70_000)
        with pytest.warns(MetadataWarning, match="cannot take over the largest parts of EXIF$"):
            write(tmp_path / f"out{suffix}", picture.pixels, like=picture)
        found = told(tmp_path / f"out{suffix}")
        assert 37500 not in found[34665]
        rest = {tag: value for tag, value in wanted[34665].items() if tag != 37500}
        assert includes(found, {**wanted, 34665: rest})
