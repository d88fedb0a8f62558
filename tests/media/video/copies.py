"""Videos copied frame by frame, and what tests say of two of them."""

import os

import numpy as np
import pytest

from supple.media.video import CountError
from supple.media.video import open_clip as open_video
from tests import clips


def arrays_of(clip, frame):
    """Return the planes of a frame, in arrays of their own."""
    arrays = [np.empty((*g.shape, g.channels), clip.layout.dtype) for g in clip.layout.groups]
    frame.copy_to(arrays)
    return arrays


def copy(source, target, *, again=True, **settings):
    """Write a clip anew, unchanged; start again where it turns out to have another number of frames."""
    count = None
    while True:
        try:
            with open_video(source, threads=2, count=count) as clip:
                with clip.writer(target, force=True, threads=2, **settings) as sink:
                    for k, frame in enumerate(clip.frames()):
                        arrays = arrays_of(clip, frame)
                        sink.write(arrays, k)
                return clip.count
        except CountError as error:
            assert again
            count = error.found


def read(path):
    """Every frame's arrays."""
    with open_video(path) as clip:
        found = []
        for frame in clip.frames():
            arrays = arrays_of(clip, frame)
            found.append(arrays)
        assert len(found) == clip.count
        return found


def assert_same_frames(source, target):
    before, after = clips.decoded(source), clips.decoded(target)
    assert len(before) == len(after)
    for a, b in zip(before, after, strict=True):
        if a.format.name != b.format.name:
            a = a.reformat(format=b.format.name, src_color_range=2, dst_color_range=2)
        if b.format.name == "bgr0":
            pick = slice(None), slice(0, 3)
            x, y = (np.frombuffer(clips.rows(frame)[0], np.uint8).reshape(-1, 4)[pick] for frame in (a, b))
            assert (x == y).all()
        else:
            assert clips.rows(a) == clips.rows(b)


def assert_nothing_left(folder, *names):
    assert sorted(os.listdir(folder)) == sorted(names)


def relative(path, kind):
    start = 0 if path.suffix == ".avi" else clips.when(path)[0]  # PyAV alone does not know the times of AVI
    return [(data, float(t - start), float(d)) for data, t, d in clips.parcels(path, kind)]


def assert_same_sound(source, target, tolerance=1e-9):
    before, after = relative(source, "audio"), relative(target, "audio")
    assert [p[0] for p in before] == [p[0] for p in after]
    assert [p[1] for p in after] == pytest.approx([p[1] for p in before], abs=tolerance)
