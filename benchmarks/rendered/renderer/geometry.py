"""Random fields, meshes, the textured support board. Lengths in mm; heights z towards the station camera."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates


def fbm(shape, step, shortest, longest, rng, beta=1.5, aniso=None):
    """Band-limited random field with standard deviation 1; wavelengths in the unit of `step`; aniso = (angle in rad, stretch)."""
    ny, nx = shape
    white = rng.standard_normal(shape).astype(np.float32)
    fy, fx = np.fft.fftfreq(ny, step)[:, None], np.fft.rfftfreq(nx, step)[None]
    if aniso:
        a, stretch = aniso
        k = np.hypot((np.cos(a) * fx + np.sin(a) * fy) * stretch, -np.sin(a) * fx + np.cos(a) * fy) + 1e-9
    else:
        k = np.hypot(fx, fy) + 1e-9
    band = k**-beta / (1 + (k * shortest) ** 8) / (1 + (1 / (k * longest)) ** 8)
    field = np.fft.irfft2(np.fft.rfft2(white) * band, s=shape)
    return field / field.std()


def sstep(x, a, b):
    """Smooth step from 0 at a to 1 at b."""
    t = np.clip((x - a) / (b - a), 0, 1)
    return t * t * (3 - 2 * t)


def smin(a, b, k):
    """Smooth minimum, exact outside |a - b| < k (facets stay exactly flat)."""
    h = np.clip(0.5 + 0.5 * (b - a) / k, 0, 1)
    return b + (a - b) * h - k * h * (1 - h)


def axes(half_x, half_y, step):
    """Coordinates x, y (1-D) and X, Y (2-D) of a height field that covers [-half, half]."""
    x, y = np.arange(-half_x, half_x + step / 2, step), np.arange(-half_y, half_y + step / 2, step)
    return (x, y, *np.meshgrid(x, y))


def grid_mesh(x, y, h, step, keep=None):
    """Vertices, normals, faces and uv of the height field h(y, x); `keep`: mask of the vertices to keep."""
    X, Y = np.meshgrid(x, y)
    gy, gx = np.gradient(h, step)
    N = np.stack([-gx, -gy, np.ones_like(h)], -1)
    N = (N / np.linalg.norm(N, axis=-1, keepdims=True)).reshape(-1, 3)
    V = np.stack([X, Y, h], -1).reshape(-1, 3)
    ny, nx = h.shape
    UV = np.stack(np.meshgrid((np.arange(nx) + 0.5) / nx, (np.arange(ny) + 0.5) / ny), -1).reshape(-1, 2)
    i = np.arange(ny * nx, dtype=np.int32).reshape(ny, nx)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]
    F = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    if keep is not None:
        V, N, UV, F = subset(V, N, UV, F[keep.reshape(-1)[F].all(1)])
    return V, N, F, UV


def subset(V, N, UV, F):
    """The mesh reduced to the vertices that the faces F use."""
    used = np.zeros(len(V), bool)
    used[F] = True
    index = np.cumsum(used) - 1
    return V[used], N[used], None if UV is None else UV[used], index[F].astype(np.int32)


def dot_target(albedo, X, Y, p, r):
    """Photogrammetric target: white ring, black disc, white center."""
    d = np.hypot(X - p[0], Y - p[1])
    albedo[d < 2.2 * r], albedo[d < 1.3 * r], albedo[d < 0.35 * r] = 0.8, 0.06, 0.8


def object_mesh(V, N, F, bsdf, uv=None, tex=None, albedo=None):
    """The object (label 1) of a scene where the object is a single mesh; its diffuse albedo is `tex` over uv, or one value."""
    return dict(name="object", V=V, N=N, F=F, uv=uv, tex=tex, albedo=albedo, bsdf=bsdf, label=1, material=1)


def board(size, z, rng, feature, points, r, px=2048, gain=1.0, turn=None):
    """Flat textured support (label 2), by which photographs can be oriented; `turn` = 3x3 matrix applied to its vertices."""
    w, h = size
    th, st = int(px * h / w), w / px
    t = 0.42 + 0.13 * fbm((th, px), st, feature, 30 * feature, rng, 1.1)
    for _ in range(int(2.2 * w * h / (feature * 8) ** 2)):
        c, s = (int(rng.uniform(0, px)), int(rng.uniform(0, th))), int(max(2, rng.uniform(0.5, 2.2) * feature / st))
        cv2.ellipse(
            t,
            c,
            (s, max(2, int(s * rng.uniform(0.4, 1)))),
            rng.uniform(0, 180),
            0,
            360,
            float(rng.uniform(0.08, 0.8)),
            -1,
        )
    t = np.clip(gaussian_filter(t, 1), 0.05, 0.85)
    X, Y = np.meshgrid(-w / 2 + (np.arange(px) + 0.5) * st, -h / 2 + (np.arange(th) + 0.5) * (h / th))
    for p in points:
        dot_target(t, X, Y, p, r)
    V = np.array([[-w / 2, -h / 2, z], [w / 2, -h / 2, z], [w / 2, h / 2, z], [-w / 2, h / 2, z]], float)
    N = np.tile([0, 0, 1.0], (4, 1))
    if turn is not None:
        V, N = V @ turn.T, N @ turn.T
    return dict(
        name="board",
        V=V,
        N=N,
        F=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        label=2,
        material=0,
        albedo=None,
        uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float),
        tex=(t * gain).astype(np.float32),
        bsdf=dict(type="pplastic", int_ior=1.5, specular_reflectance=1.0, alpha=0.35),
    )


def text_ring(word, radius, px_mm=20.0, scale=1.25, thickness=3, start=0.9 * np.pi, size=900):
    """Raster of letters around a circle; sample it with `sample_raster`."""
    out = np.zeros((size, size), np.float32)
    for k, letter in enumerate(word):
        a = start - 2 * np.pi * k / len(word)
        cell = np.zeros((80, 80), np.uint8)
        (w, h), _ = cv2.getTextSize(letter, cv2.FONT_HERSHEY_DUPLEX, scale, thickness)
        cv2.putText(
            cell, letter, (40 - w // 2, 40 + h // 2), cv2.FONT_HERSHEY_DUPLEX, scale, 255, thickness, cv2.LINE_AA
        )
        M = cv2.getRotationMatrix2D((40, 40), np.degrees(a) - 90, 1.0)
        M[:, 2] += [size / 2 + radius * px_mm * np.cos(a) - 40, size / 2 - radius * px_mm * np.sin(a) - 40]
        out = np.maximum(out, cv2.warpAffine(cell.astype(np.float32) / 255, M, (size, size)))
    return out


def sample_raster(raster, X, Y, px_mm=20.0, blur=1.6):
    c = raster.shape[0] / 2
    return cv2.remap(
        gaussian_filter(raster, blur),
        (X * px_mm + c).astype(np.float32),
        (c - Y * px_mm).astype(np.float32),
        cv2.INTER_CUBIC,
    )


def local(X, Y, cx, cy, angle):
    """Coordinates along and across a direction, about (cx, cy)."""
    dx, dy = X - cx, Y - cy
    return dx * np.cos(angle) + dy * np.sin(angle), -dx * np.sin(angle) + dy * np.cos(angle)


def window(x, y, cx, cy, r):
    """Slices of the height field within r of (cx, cy); None if they are empty."""
    j0, j1 = np.searchsorted(x, [cx - r, cx + r])
    i0, i1 = np.searchsorted(y, [cy - r, cy + r])
    return (slice(i0, i1), slice(j0, j1)) if i1 > i0 and j1 > j0 else None


def cut_wedge(det, x, y, X, Y, px, py, angle, length, width, depth):
    """Press one cuneiform wedge (a triangular pyramid, deep at its head) into det."""
    w = window(x, y, px, py, length + width)
    if w is None:
        return
    u, v = local(X[w], Y[w], px, py, angle)
    d = np.clip(np.minimum(2 * depth / width * (width / 2 * (1 - u / length) - np.abs(v)), 1.4 * u), 0, None)
    det[w] = np.minimum(det[w], -d)


def flat_square(z, plane, X, Y, step, name):
    """Largest centered square on which z is exactly the plane, as an entry of scene['flat']."""
    near = cv2.distanceTransform((np.abs(z - plane) < 1e-9).astype(np.uint8), cv2.DIST_C, 3)
    i, j = np.unravel_index(np.argmax(near), near.shape)
    half = float(near[i, j] * step * 0.93 - 0.3 * min(1, step / 0.06))
    return dict(name=name, c=[float(X[i, j]), float(Y[i, j])], half=[half, half])


def surface_nets(f, origin, step, newton=3):
    """Closed mesh of the zero level set of f[x, y, z] (negative inside). Vertices are moved onto the level set; normals are the gradient."""
    inside = f < 0
    shape = np.array(f.shape) - 1
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    part = lambda a, c: a[c[0] : c[0] + shape[0], c[1] : c[1] + shape[1], c[2] : c[2] + shape[2]]
    count = sum(part(inside, c).astype(np.int8) for c in corners)
    cells = np.argwhere((count > 0) & (count < 8))
    number = np.full(shape, -1, np.int32)
    number[tuple(cells.T)] = np.arange(len(cells))
    total, n = np.zeros((len(cells), 3)), np.zeros(len(cells))
    for a in corners:
        for axis in range(3):
            if a[axis]:
                continue
            b = tuple(1 if i == axis else a[i] for i in range(3))
            fa, fb = f[tuple((cells + a).T)].astype(float), f[tuple((cells + b).T)].astype(float)
            cut = (fa < 0) != (fb < 0)
            p = np.tile(np.array(a, float), (len(cells), 1))
            p[:, axis] += np.where(cut, fa / np.where(cut, fa - fb, 1), 0)
            total[cut] += p[cut]
            n[cut] += 1
    V = cells + total / n[:, None]
    faces = []
    for axis in range(3):
        o1, o2 = [(axis + 1) % 3, (axis + 2) % 3]
        lo = [slice(1, s) for s in shape]
        lo[axis] = slice(0, shape[axis])
        hi = list(lo)
        hi[axis] = slice(1, shape[axis] + 1)
        a, b = inside[tuple(lo)], inside[tuple(hi)]
        e = np.argwhere(a != b) + [0 if i == axis else 1 for i in range(3)]
        flip = inside[tuple(e.T)]
        e1, e2 = np.eye(3, dtype=int)[o1], np.eye(3, dtype=int)[o2]
        q = [number[tuple((e - d).T)] for d in (0 * e1, e1, e1 + e2, e2)]
        q = np.stack(q, 1)
        q[~flip] = q[~flip][:, ::-1]
        faces += [q[:, [0, 1, 2]], q[:, [0, 2, 3]]]
    F = np.concatenate(faces).astype(np.int32)
    g = np.gradient(f)
    sample = lambda a, p: map_coordinates(a, p.T, order=1)
    for _ in range(newton):
        G = np.stack([sample(c, V) for c in g], 1)
        V = V - np.clip(sample(f, V) / np.maximum((G**2).sum(1), 1e-6), -0.5, 0.5)[:, None] * G
    N = np.stack([sample(c, V) for c in g], 1)
    return V * step + origin, N / np.linalg.norm(N, axis=1, keepdims=True), F


def close_holes(V, N, F):
    """Closes every open border with a fan of triangles, for example where the shape leaves the grid of `surface_nets`."""
    directed = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]]).astype(np.int64)
    code = lambda e: e[:, 0] * len(V) + e[:, 1]
    border = directed[~np.isin(code(directed), code(directed[:, ::-1]))]
    following = dict(map(tuple, border[:, ::-1].tolist()))  # against the faces' orientation
    V, N, F = [V], [N], [F]
    while following:
        a, b = following.popitem()
        loop = [a]
        while b in following:
            loop.append(b)
            b = following.pop(b)
        center = sum(map(len, V))
        p = V[0][loop]
        V.append(p.mean(0, keepdims=True))
        fan = np.array([[loop[i], loop[(i + 1) % len(loop)], center] for i in range(len(loop))], np.int32)
        n = np.cross(p - V[-1], np.roll(p, -1, 0) - V[-1]).sum(0, keepdims=True)
        N.append(n / max(np.linalg.norm(n), 1e-12))
        F.append(fan)
    return np.concatenate(V), np.concatenate(N), np.concatenate(F)


def star_shaped(radius, n):
    """Vertices, normals, faces and directions of the surface at radius(direction): a cube with n x n vertices on each side, inflated."""
    A, B = np.meshgrid(*[np.tan(np.linspace(-np.pi / 4, np.pi / 4, n))] * 2)
    o = np.ones_like(A)
    i = np.arange(n * n, dtype=np.int32).reshape(n, n)
    a, b, c, e = i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]
    F0 = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, e], -1).reshape(-1, 3)])
    unit = lambda v: v / np.linalg.norm(v, axis=-1, keepdims=True)
    V, N, F, D = [], [], [], []
    for side in ((A, B, o), (-A, B, -o), (o, B, -A), (-o, B, A), (A, o, -B), (A, -o, B)):
        d = unit(np.stack(side, -1))
        r, h, slope = radius(d), 1e-4, 0
        t1 = unit(np.cross(np.where(np.abs(d[..., 1:2]) < 0.9, [0, 1.0, 0], [1.0, 0, 0]), d))
        for t in (t1, np.cross(d, t1)):
            slope = slope + t * ((radius(unit(d + h * t)) - radius(unit(d - h * t))) / (2 * np.arctan(h)))[..., None]
        P, f = (d * r[..., None]).reshape(-1, 3), F0
        tri = P[f[len(f) // 4]]
        if np.cross(tri[1] - tri[0], tri[2] - tri[0]) @ tri.mean(0) < 0:
            f = f[:, ::-1]
        F.append(f + n * n * len(V))
        V.append(P)
        N.append(unit(d - slope / r[..., None]).reshape(-1, 3))
        D.append(d.reshape(-1, 3))
    faces = np.ascontiguousarray(np.concatenate(F)).astype(np.int32)
    return np.concatenate(V), np.concatenate(N), faces, np.concatenate(D)
