"""A volume seen through a camera: rays from the eye, their first surface, and what lies behind it.

The paper's Algorithm 3: where a ray enters the box, its first sample above a threshold, the surface before that by
bisection, and samples from there on through a transfer function. They are composited front to back,
c ← c + (1 - α) α_v c_v and α ← α + (1 - α) α_v, which gives what the paper's back to front does, and can stop early.

A deformed volume is sampled at p = T⁻¹(q), and its gradient is (∂p/∂q)ᵀ ∇f.

A view is float64 of shape (5, 3): the eye, in indices; the spacing; and, in millimetres along the volume's axes, where
the camera looks, and a pixel to the right and one down, a millimetre ahead. Pixels are counted from the middle.
"""

from __future__ import annotations

import numpy as np

from supple.cpu.bricks import BRICK
from supple.cpu.field import J00, J01, J02, J10, J11, J12, J20, J21, J22, X
from supple.cpu.kernel import BATCH, colour_kernel, inlined, lean
from supple.cpu.newton import PX, QX, ROWS, STEPS, settle
from supple.cpu.solid import displacement, transposed
from supple.cpu.voxels import sample_at, slopes_at

BISECTIONS = 2  # before the surface is found by a straight line between two values, in a quarter of a step
OPAQUE = 0.995  # where a ray ends
FAINT = 4e-3  # what a sample adds at most, where nobody sees its shading: a step of 8 bits
AMBIENT, DIFFUSE, SPECULAR, SHININESS = 0.15, 0.8, 0.2, 4
PLAIN, LATTICE = 0, 1


@lean
def ray_of(view, x, y):
    """Where a pixel's ray goes: in indices a millimetre, and in millimetres along the axes."""
    a = view[2, 0] + x * view[3, 0] + y * view[4, 0]
    b = view[2, 1] + x * view[3, 1] + y * view[4, 1]
    c = view[2, 2] + x * view[3, 2] + y * view[4, 2]
    size = 1.0 / np.sqrt(a * a + b * b + c * c)
    a, b, c = a * size, b * size, c * size
    return a / view[1, 0], b / view[1, 1], c / view[1, 2], a, b, c


@lean
def box_of(ox, oy, oz, dx, dy, dz, nx, ny, nz):
    """Where a ray enters and leaves the box between the outermost voxels' centres."""
    near, far = 0.0, 1e300
    for o, d, n in ((ox, dx, nx), (oy, dy, ny), (oz, dz, nz)):
        if d == 0.0:
            if o < 0.0 or o > n - 1.0:
                return 1.0, 0.0
        else:
            a, b = -o / d, (n - 1.0 - o) / d
            near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far


@lean
def _entry(table, low, scale, value):
    """Which row of a transfer function a value has."""
    top = np.float32(table.shape[0] - 1)
    return np.uint32(min(max((value - low) * scale, np.float32(0.0)), top) + np.float32(0.5))


@lean
def _halfway(light, ax, ay, az, out):
    """The direction between that to the light and that to the eye, of a ray along (ax, ay, az)."""
    hx, hy, hz = light[0] - np.float32(ax), light[1] - np.float32(ay), light[2] - np.float32(az)
    scale = np.float32(1.0) / max(np.sqrt(hx * hx + hy * hy + hz * hz), np.float32(1e-6))
    out[0], out[1], out[2] = hx * scale, hy * scale, hz * scale


@lean
def _lit(gx, gy, gz, light, half):
    """Ambient and diffuse light, and the highlight, of a surface with a gradient.

    ``light`` points to the light, and ``half`` between it and the eye; both sides of a surface are lit.
    """
    zero = np.float32(0.0)
    size = gx * gx + gy * gy + gz * gz
    if not size > zero:
        return np.float32(AMBIENT + DIFFUSE), zero
    scale = np.float32(1.0) / np.sqrt(size)
    nx, ny, nz = gx * scale, gy * scale, gz * scale
    diffuse = abs(nx * light[0] + ny * light[1] + nz * light[2])
    shine = abs(nx * half[0] + ny * half[1] + nz * half[2])
    for _ in range(SHININESS):
        shine *= shine
    return np.float32(AMBIENT) + np.float32(DIFFUSE) * diffuse, np.float32(SPECULAR) * shine


@lean
def _source(nodes, per_voxel, mode, x, y, z):
    """T⁻¹ by the lattice, or the point itself."""
    if mode == LATTICE:
        dx, dy, dz = displacement(nodes, per_voxel, x, y, z)
        x, y, z = x + dx, y + dy, z + dz
    return x, y, z


@lean
def _over(d):
    """The inverse of a direction, large where there is none."""
    return 1.0 / d if abs(d) > 1e-12 else 1e12


@colour_kernel
def march(
    samples, size, nodes, per_voxel, mode, skips, table, low, scale, threshold, window, view, pixels, step, light,
    shaded, out, depth, work,
):  # fmt: skip
    """See a volume along some rays.

    Parameters
    ----------
    samples : flat array
        Of a type that float32 holds.
    size : int64 array (nx, ny, nz)
    nodes, per_voxel, mode
        The lattice of T⁻¹, in indices, float32 of shape (., ., ., FIELDS); its nodes per voxel; PLAIN to do without.
    skips : uint8 array (bricks z, y, x)
        How many bricks away the next one is that anything is seen of.
    table : float32 array (entries, 4)
        The transfer function: linear red, green and blue, and the opacity of a step.
    low, scale : float32
        Which entry a value has.
    threshold : float32
        Below it, nothing is seen before the first surface.
    window : float32 array (2)
        The values that are seen at all.
    view : float64 array (5, 3)
    pixels : float64 array (n, 2)
        x and y.
    step : float
        Millimetres from sample to sample.
    light : float32 array (3)
        Where it comes from, in millimetres along the axes.
    shaded : bool
    out : float32 array (n, 4)
        Receives premultiplied linear colour, and opacity.
    depth : float64 array (n, 2)
        Receives how far the first surface is, in millimetres, and where opacity passes 0.9; infinity, if never.
    work : int64 array (n, 2)
        Receives the samples that were taken; the second is left for inversions.
    """
    nx, ny, nz = size[0], size[1], size[2]
    wide, high, deep = np.uint32(skips.shape[2] - 1), np.uint32(skips.shape[1] - 1), np.uint32(skips.shape[0] - 1)
    unseen, zero, one = np.float32(FAINT), np.float32(0.0), np.float32(1.0)
    half = np.empty(3, np.float32)
    ox, oy, oz = view[0, 0], view[0, 1], view[0, 2]
    sx, sy, sz = np.float32(1.0 / view[1, 0]), np.float32(1.0 / view[1, 1]), np.float32(1.0 / view[1, 2])
    bottom, top, over = window[0], window[1], 1.0 / step
    for r in range(pixels.shape[0]):
        dx, dy, dz, ax, ay, az = ray_of(view, pixels[r, 0], pixels[r, 1])
        _halfway(light, ax, ay, az, half)
        red = green = blue = alpha = np.float32(0.0)
        surface, opaque, taken = np.inf, np.inf, 0
        near, far = box_of(ox, oy, oz, dx, dy, dz, nx, ny, nz)
        over_x, over_y, over_z = _over(dx), _over(dy), _over(dz)
        t, found, within = near, threshold == -np.inf, False
        if found and near <= far:
            surface = near
        while t <= far:
            qx, qy, qz = np.float32(ox + t * dx), np.float32(oy + t * dy), np.float32(oz + t * dz)
            if not within:
                bx = min(np.uint32(max(qx, zero)) // np.uint32(BRICK), wide)
                by = min(np.uint32(max(qy, zero)) // np.uint32(BRICK), high)
                bz = min(np.uint32(max(qz, zero)) // np.uint32(BRICK), deep)
                away = np.float64(skips[bz, by, bx])
                if away > 0.0:
                    # To where the ray leaves the bricks around that are empty too.
                    x = BRICK * (np.float64(bx) + (away if dx > -1e-12 else 1.0 - away))
                    y = BRICK * (np.float64(by) + (away if dy > -1e-12 else 1.0 - away))
                    z = BRICK * (np.float64(bz) + (away if dz > -1e-12 else 1.0 - away))
                    leave = min((x - ox) * over_x, min((y - oy) * over_y, (z - oz) * over_z))
                    t += step * max(1.0, np.ceil((leave - t) * over - 1e-4))
                    continue
            within = False
            px, py, pz = _source(nodes, per_voxel, mode, qx, qy, qz)
            value = sample_at(samples, nx, ny, nz, px, py, pz)
            taken += 1
            if not found:
                if not (value >= threshold and value <= top):
                    t += step
                    continue
                found = True
                # The surface lies within the last step.
                low_t, before = max(near, t - step), np.float32(-np.inf)
                for turn in range(BISECTIONS + 1):
                    middle = 0.5 * (low_t + t)
                    if turn == BISECTIONS:
                        if not (np.float32(-np.inf) < before and before < threshold):
                            break
                        middle = low_t + (t - low_t) * np.float64((threshold - before) / (value - before))
                    mx, my, mz = (
                        np.float32(ox + middle * dx),
                        np.float32(oy + middle * dy),
                        np.float32(oz + middle * dz),
                    )
                    ux, uy, uz = _source(nodes, per_voxel, mode, mx, my, mz)
                    inner = sample_at(samples, nx, ny, nz, ux, uy, uz)
                    taken += 1
                    if turn == BISECTIONS or (inner >= threshold and inner <= top):
                        t, px, py, pz, value = middle, ux, uy, uz, inner
                        qx, qy, qz = mx, my, mz
                    else:
                        low_t, before = middle, inner
                surface = t
            if value >= bottom and value <= top:
                entry = _entry(table, low, scale, value)
                opacity = table[entry, 3]
                if opacity > zero:
                    within = True  # where something is seen, the next sample is most likely too
                    lit, shine, part = one, zero, (one - alpha) * opacity
                    if shaded and part > unseen:
                        fx, fy, fz = slopes_at(samples, nx, ny, nz, px, py, pz)
                        if mode == LATTICE:
                            fx, fy, fz = transposed(nodes, per_voxel, qx, qy, qz, fx, fy, fz)
                        lit, shine = _lit(fx * sx, fy * sy, fz * sz, light, half)
                    red += part * (table[entry, 0] * lit + shine)
                    green += part * (table[entry, 1] * lit + shine)
                    blue += part * (table[entry, 2] * lit + shine)
                    alpha += part
                    if opaque == np.inf and alpha >= np.float32(0.9):
                        opaque = t
                    if alpha > np.float32(OPAQUE):
                        break
            t += step
        out[r, 0], out[r, 1], out[r, 2], out[r, 3] = red, green, blue, alpha
        depth[r, 0], depth[r, 1], work[r, 0] = surface, opaque, taken


@inlined
def _invert(w, one, n, view, rays, which, ts, shift, table, axes, finest, work):
    """T⁻¹ of the points of ``n`` rays: into the rows PX.., from displacements that are known nearby."""
    for m in range(n):
        r = which[m]
        for c in range(3):
            q = (view[0, c] + ts[r] * rays[r, c]) * view[1, c]
            w[QX + c * BATCH + m] = q
            w[X + c * BATCH + m] = q + shift[r, c]
    settle(w, one, n, table, axes, finest, 10)
    for m in range(n):
        r = which[m]
        work[r, 1] += np.int64(w[STEPS + m])
        for c in range(3):
            shift[r, c] = w[PX + c * BATCH + m] - w[QX + c * BATCH + m]


@colour_kernel
def march_exactly(
    samples, size, strokes, axes, finest, table, low, scale, threshold, window, view, pixels, step, light, shaded, out,
    depth, work,
):  # fmt: skip
    """The same, but every sample along every ray is inverted by Newton's method, up to BATCH rays side by side.

    ``strokes``, ``axes`` and ``finest`` are as the solver takes them; each sample starts from the displacement of the
    one before.
    """
    nx, ny, nz = size[0], size[1], size[2]
    w, one, alone = np.empty(ROWS * BATCH), np.empty(ROWS * BATCH), np.empty(ROWS * BATCH)
    unit = np.float32(1.0)
    spacing = view[1]
    n = pixels.shape[0]
    rays = np.empty((n, 6))
    ts, nears, fars, shift = np.empty(n), np.empty(n), np.empty(n), np.zeros((n, 3))
    found, which, single = np.zeros(n, np.bool_), np.empty(BATCH, np.int64), np.empty(1, np.int64)
    half = np.empty(3, np.float32)
    for first in range(0, n, BATCH):
        last = min(first + BATCH, n)
        count = 0
        for r in range(first, last):
            dx, dy, dz, ax, ay, az = ray_of(view, pixels[r, 0], pixels[r, 1])
            rays[r, 0], rays[r, 1], rays[r, 2], rays[r, 3], rays[r, 4], rays[r, 5] = dx, dy, dz, ax, ay, az
            near, far = box_of(view[0, 0], view[0, 1], view[0, 2], dx, dy, dz, nx, ny, nz)
            ts[r], nears[r], fars[r], found[r] = near, near, far, threshold == -np.inf
            depth[r, 0], depth[r, 1], work[r, 0], work[r, 1] = np.inf, np.inf, 0, 0
            out[r, 0] = out[r, 1] = out[r, 2] = out[r, 3] = np.float32(0.0)
            if near <= far:
                which[count] = r
                count += 1
                if found[r]:
                    depth[r, 0] = near
        while count > 0:
            _invert(w, one, count, view, rays, which, ts, shift, strokes, axes, finest, work)
            left = 0
            for m in range(count):
                r = which[m]
                x, y, z = w[PX + m] / spacing[0], w[PX + BATCH + m] / spacing[1], w[PX + 2 * BATCH + m] / spacing[2]
                value = sample_at(samples, nx, ny, nz, x, y, z)
                work[r, 0] += 1
                ended = False
                if not found[r] and value >= threshold and value <= window[1]:
                    found[r] = True
                    single[0] = r
                    high_t, low_t = ts[r], max(nears[r], ts[r] - step)
                    above, before = value, np.float32(-np.inf)
                    for turn in range(BISECTIONS + 1):
                        ts[r] = 0.5 * (low_t + high_t)
                        if turn == BISECTIONS:
                            known = np.float32(-np.inf) < before and before < threshold
                            part = (threshold - before) / (above - before) if known else unit
                            ts[r] = low_t + (high_t - low_t) * np.float64(part)
                        _invert(alone, one, 1, view, rays, single, ts, shift, strokes, axes, finest, work)
                        x, y = alone[PX] / spacing[0], alone[PX + BATCH] / spacing[1]
                        z = alone[PX + 2 * BATCH] / spacing[2]
                        value = sample_at(samples, nx, ny, nz, x, y, z)
                        work[r, 0] += 1
                        if value >= threshold and value <= window[1]:
                            high_t, above = ts[r], value
                        else:
                            low_t, before = ts[r], value
                    depth[r, 0] = ts[r]
                    for c in range(9):
                        w[J00 + c * BATCH + m] = alone[J00 + c * BATCH]
                if found[r] and value >= window[0] and value <= window[1]:
                    entry = _entry(table, low, scale, value)
                    opacity = table[entry, 3]
                    if opacity > np.float32(0.0):
                        lit, shine, part = unit, np.float32(0.0), (unit - out[r, 3]) * opacity
                        if shaded and part > np.float32(FAINT):
                            fx, fy, fz = slopes_at(samples, nx, ny, nz, x, y, z)
                            # In millimetres, ∇_q g = (I+J)⁻ᵀ ∇_p f.
                            fx, fy, fz = fx / spacing[0], fy / spacing[1], fz / spacing[2]
                            a, b, c = w[J00 + m], w[J01 + m], w[J02 + m]
                            d, e, f = w[J10 + m], w[J11 + m], w[J12 + m]
                            g, h, k = w[J20 + m], w[J21 + m], w[J22 + m]
                            ca, cb, cc = e * k - f * h, f * g - d * k, d * h - e * g
                            over = 1.0 / (a * ca + b * cb + c * cc)
                            gx = over * (ca * fx + cb * fy + cc * fz)
                            gy = over * ((c * h - b * k) * fx + (a * k - c * g) * fy + (b * g - a * h) * fz)
                            gz = over * ((b * f - c * e) * fx + (c * d - a * f) * fy + (a * e - b * d) * fz)
                            _halfway(light, rays[r, 3], rays[r, 4], rays[r, 5], half)
                            lit, shine = _lit(np.float32(gx), np.float32(gy), np.float32(gz), light, half)
                        for channel in range(3):
                            out[r, channel] += part * (table[entry, channel] * lit + shine)
                        out[r, 3] += part
                        if depth[r, 1] == np.inf and out[r, 3] >= np.float32(0.9):
                            depth[r, 1] = ts[r]
                        ended = out[r, 3] > np.float32(OPAQUE)
                ts[r] += step
                if not ended and ts[r] <= fars[r]:
                    which[left] = r
                    left += 1
            count = left
