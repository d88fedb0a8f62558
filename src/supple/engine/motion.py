"""The motion between two frames: the optical flow of pairs, and how far samples may follow it.

For each pair of frames that is mixed, and each place halfway in time, `motion_between` has the displacement v of the
point there from one frame to the next, and the weight of the sample that follows it; the plain mixture has the rest of
the weight. The criteria and their numbers were measured on clips without every other frame (benchmarks/between.py).
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from supple.engine.work import Array, Space, Work
from supple.errors import need

Grey = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

APART = 4  # pixels between displacements; flow is computed from averages of 2 x 2 pixels
LEAST = 16  # displacements along an axis: frames of smaller parts are mixed
CUT = -1.0  # the value of ``longest`` at a cut: one frame replaces the other
_AROUND = 64  # pixels around the reach of strokes from which motion may come
_SETTING = threading.Lock()  # OpenCV's number of threads is one for all of a process
_STRIPES = 8  # of a frame: OpenCV's threads, on whose number the flow depends
_ALONE = 1 << 16  # pixels up to which one thread is faster
_SMOOTH = 3.0  # lattice steps: the sigma of the averages of differences
_ALIKE = 0.5  # lattice steps: up to this distance, both directions are averaged
_STRAY = 0.7, 0.85  # parts of the change where directions disagree, between which trust ends
# A filter that leaves of a picture little but its noise (Immerkær, 1996), and by how much the mean difference of two
# pictures of such noise, 2 σ / √π, is less than the median of its size, 0.6745 · 6 σ. Of smoothed differences, a fifth
# are less than 1 / 1.08 of that mean.
_ROUGH, _NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32), 0.279
_SHOTS = 15.0  # of 255 levels: where the median difference, after motion, is larger, it may be a cut
# The part of the change that motion must explain, above which trust fades in over _FADES. For motions of few pixels
# (_MOVED), it rises with the part of equal samples (_SAME), which hard compression leaves; for long ones, it is _FAR.
_SAME, _MOVED, _FAR, _FADES = ((0.42, 0.53), (0.4, 0.7)), (1.2, 6.0), 0.1, 0.15


def need_flow() -> None:
    """Raise SuppleError without OpenCV."""
    need("flow", "samples that follow the motion between frames", "cv2")


class Moving(NamedTuple):
    """Motion as the core takes it.

    ``fields`` has the pairs of frames in slots, (slots, h, w, 4): v in pixels, x first, its weight, and 0. ``longest``
    has the length of each slot's longest v: 0 for the plain mixture, `CUT` at a cut. The first v is at (``x``, ``y``)
    in pixels, and neighbours are ``apart`` pixels from each other.
    """

    fields: Floats
    longest: list[float]
    x: float
    y: float
    apart: float


def motion_between(one: Grey, other: Grey, keep_grain: bool = False) -> tuple[Floats, float]:
    """Return the displacements of a pair of frames, and the longest, as `Moving` has them.

    Parameters
    ----------
    one, other : uint8 array, shape (h, w)
        The brightness of both, averaged over 2 × 2 pixels; h and w are even.
    keep_grain : bool
        Whether what may be noise alone is of one frame, even where motion explains it by chance.

    Returns
    -------
    fields : float32 array, shape (h / 2, w / 2, 4)
    longest : float
        In pixels.
    """
    import cv2

    shape = one.shape[1] // 2, one.shape[0] // 2
    fields = np.zeros((*shape[::-1], 4), np.float32)
    if min(shape) < LEAST:
        return fields, 0.0

    def coarse(array: Any) -> Any:
        return cv2.resize(array, shape, interpolation=cv2.INTER_AREA)

    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow.setVariationalRefinementIterations(0)  # a third of the time, for 0.1 dB
    flow.setGradientDescentIterations(20)
    with _SETTING:
        threads = cv2.getNumThreads()
        cv2.setNumThreads(_STRIPES if one.size > _ALONE else 1)
        try:
            there, back = (coarse(flow.calc(a, b, None)) / 2 for a, b in ((one, other), (other, one)))
        finally:
            cv2.setNumThreads(threads)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape))
    images = [coarse(image).astype(np.float32) for image in (one, other)]

    def shifted(array: Any, v: Any, by: float) -> Any:
        return cv2.remap(array, x + by * v[..., 0], y + by * v[..., 1], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)

    def differ(v: Any) -> Any:
        """Return the mean difference of the samples at both ends of v, around each place."""
        return smooth(np.abs(shifted(images[0], v, -0.5) - shifted(images[1], v, 0.5)))

    def smooth(array: Any) -> Any:
        return cv2.GaussianBlur(array, (0, 0), _SMOOTH)

    # Solve v = F(p - v/2), and v = -G(p + v/2): F is the flow there, G the flow back.
    ends = []
    for field, by in ((there, -0.5), (-back, 0.5)):
        v = field
        for _ in range(2):
            v = shifted(field, v, by)
        ends.append(v)
    ways = [differ(v) for v in ends]
    noise = float(np.median(np.minimum(*ways)))  # the difference that remains where the motion is right
    first = 1 / (1 + np.exp(np.clip((ways[0] - ways[1]) / (2 + 0.5 * noise), -30, 30)))
    contrary = cv2.magnitude(*cv2.split(ends[0] - ends[1]))
    far = np.clip(contrary / _ALIKE - 1, 0, 1)
    first = (first * (1 - far) + (first > 0.5) * far)[..., None]
    v = first * ends[0] + (1 - first) * ends[1]
    moved, still = differ(v), smooth(np.abs(images[0] - images[1]))
    # For the whole pair, weighted by the change: does motion explain it? It does not at cuts, nor for the noise of
    # codecs, which mix frames themselves.
    whole = float(still.sum()) + 1e-6
    length = cv2.magnitude(*cv2.split(v))
    stray = float(still[contrary > 1 + 0.15 * length].sum()) / whole
    if noise > _SHOTS and stray > 0.5:
        return fields, CUT
    change, rest = (float((still * each).sum()) / whole for each in (still, moved))
    least = np.interp(np.count_nonzero(one == other) / one.size, *_SAME)  # codecs mix frames where nothing moves
    asked = np.interp(APART * float((still * length).sum()) / whole, _MOVED, (least, _FAR))
    explained = 1 - max(rest - noise, 0) / max(change - noise, 0.5)
    trust = _step((explained - asked) / _FADES) * _step((_STRAY[1] - stray) / (_STRAY[1] - _STRAY[0]))
    # At each place: no weight where the plain mixture agrees as well.
    slack = 0.2 + 1.5 * noise
    ratio = (np.maximum(moved - noise, 0) + slack) / (np.maximum(still - noise, 0) + slack)
    weight = np.clip(1.4 + 0.05 * max(noise - 1.5, 0) - 1.3 * ratio, 0, 1) * trust
    v *= APART * (cv2.dilate(weight, np.ones((3, 3))) > 0)[..., None]
    # Nothing but noise: both frames show the same at the same place.
    same = still < 1.17 * noise + 0.25
    if keep_grain:  # on flat ground, flow follows the noise itself, and what it leaves is too little
        rough = np.median([np.median(np.abs(cv2.filter2D(image, -1, _ROUGH))) for image in images])
        least_change = float(np.quantile(still, 0.2))
        same |= (still < 1.17 * min(_NOISE * rough, 1.08 * least_change) + 0.25) & (moved > 0.4 * still)
    weight[same] = 1
    v[same] = 0
    fields[..., :2], fields[..., 2] = v, weight
    return fields, max(float(cv2.magnitude(*cv2.split(v)).max()), 1e-3)


def _step(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3 - 2 * t)


class Motion:
    """The motion between the frames of a window, computed once for each pair that is mixed.

    Parameters
    ----------
    work : Work
        A map through a clip.
    window : sequence of array
        The frames in slots, for each group of the layout, as `supple.engine.core.samplings_of` takes them.
    fields : float32 array
        For `Moving.fields`, of a shape that `shape_of` returns.
    """

    def __init__(self, work: Work, window: Sequence[Array], fields: Floats) -> None:
        need_flow()
        self._layout, self._frames, self._keep_grain = work.layout, window[0], work.sampling.averages_frames
        x0, _, y0, _ = self._box = _reached(work.space)
        slots, middle = len(window[0]), (APART - 1) / 2
        self._pairs = np.full(slots, -1)
        self._grey: dict[int, Any] = {}
        self._moving = Moving(fields, [0.0] * slots, x0 + middle, y0 + middle, APART)

    @staticmethod
    def shape_of(work: Work, slots: int) -> tuple[int, int, int, int]:
        """Return the shape of ``fields`` for the pairs in a number of slots."""
        x0, x1, y0, y1 = _reached(work.space)
        return slots, -(-(y1 - y0) // APART), -(-(x1 - x0) // APART), 4

    def between(self, pairs: range) -> Moving | None:
        """Return the motion of all pairs k, k + 1 of a range, whose frames are in the window; None if all are mixed."""
        if min(self._moving.fields.shape[1:3]) < LEAST:
            return None
        for k in pairs:
            slot = k % len(self._pairs)
            if self._pairs[slot] != k:
                one, other = self._levels(self._brightness(k), self._brightness(k + 1))
                self._moving.fields[slot], self._moving.longest[slot] = motion_between(one, other, self._keep_grain)
                self._pairs[slot] = k
        self._grey = {k: grey for k, grey in self._grey.items() if k >= pairs.start}
        slots = {k % len(self._pairs) for k in pairs}  # without the pairs of earlier planes
        longest = [length if slot in slots else 0.0 for slot, length in enumerate(self._moving.longest)]
        return self._moving._replace(longest=longest) if any(longest) else None

    def _brightness(self, k: int) -> Any:
        """Return a frame's luma, or the mean of its first colours, averaged over 2 × 2 pixels."""
        import cv2

        if k not in self._grey:
            group = self._layout.groups[0]
            x0, x1, y0, y1 = self._box
            part = self._frames[k % len(self._frames), y0:y1, x0:x1, : min(group.channels - group.alpha, 3)]
            if part.dtype.str[1:] not in ("u1", "u2", "f4"):
                part = part.astype(np.float32)
            down, across = (-n % APART for n in part.shape[:2])
            made = cv2.copyMakeBorder(np.ascontiguousarray(part), 0, down, 0, across, cv2.BORDER_REPLICATE)
            made = cv2.resize(made, (made.shape[1] // 2, made.shape[0] // 2), interpolation=cv2.INTER_AREA)
            self._grey[k] = made if made.ndim == 2 else made.mean(axis=2, dtype=np.float32)
        return self._grey[k]

    def _levels(self, *frames: Any) -> list[Grey]:
        """Return frames scaled to 8 bits: from the range of the format or, if it has none, from that of the samples."""
        low, high = 0.0, self._layout.white
        if self._layout.dtype.str[1:] not in ("u1", "u2") or high > 65534:
            some = np.concatenate([frame[::4, ::4].ravel() for frame in frames])
            low, high = np.nanpercentile(some[np.isfinite(some)], (0.5, 99.5)) if np.isfinite(some).any() else (0, 1)
        if (low, high) == (0.0, 255.0) and frames[0].dtype == np.uint8:
            return list(frames)
        scale = 255 / max(high - low, 1e-30)
        return [np.clip(np.nan_to_num(frame - low) * scale, 0, 255).astype(np.uint8) for frame in frames]


def _reached(space: Space) -> tuple[int, int, int, int]:
    """Return the part (x0, x1, y0, y1) of frames from which the motion of moved pixels may come, in whole averages."""
    height, width = space.shape
    if space.composite is not None:
        return 0, width, 0, height
    ends = []
    for axis, size in enumerate((width, height)):
        at, reach = (space.table[name] / space.axes[axis, 3] for name in ("pivot", "reach"))
        low, high = float((at[:, axis] - reach).min()) - _AROUND, float((at[:, axis] + reach).max()) + _AROUND
        ends += [int(max(low, 0)) // APART * APART, int(min(high, size - 1) + 1)]
    return ends[0], max(ends[1], ends[0]), ends[2], max(ends[3], ends[2])
