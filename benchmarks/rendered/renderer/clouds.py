"""A point cloud that imitates a plausible result of stereo: over-smoothed, noisy, with correlated errors, outliers and holes."""

import numpy as np
from geometry import fbm
from scipy.ndimage import gaussian_filter


def from_view(truth, gray, keep, noise, gsd, rng, blur, share, outliers=0.03):
    """Points, normals, grays from one view's truth. keep = {label: share of the points that are found}; noise on the object in GSD."""
    z, normal, label, cam = truth["z"], truth["normal"], truth["label"], truth["cam"]
    H, W = z.shape
    smooth = np.zeros_like(z)
    for l in keep:
        w = (label == l).astype(float)
        if w.any():
            smooth = np.where(
                label == l,
                gaussian_filter(np.where(label == l, z, 0), blur) / np.maximum(gaussian_filter(w, blur), 1e-6),
                smooth,
            )
    correlated = 0.35 * fbm((H, W), 1.0, 12, 60, rng, 1.0)
    if noise > 1:
        correlated += 0.3 * noise * fbm((H, W), 1.0, 25, 200, rng, 1.0)
    holes = fbm((H, W), 1.0, 25, 200, rng, 1.2)
    ok = np.isin(label, list(keep))
    for l, k in keep.items():
        lost = 0.8 * (1 - k)
        ok &= ~(
            (label == l)
            & ((holes < np.quantile(holes, max(0.0, lost))) | (rng.random((H, W)) > k / max(1e-6, 1 - lost)))
        )
    far = z[label > 0].max()
    ok &= np.hypot(*np.gradient(np.where(label > 0, z, far))) < 6 * gsd  # grazing surfaces and depth edges fail
    ok &= rng.random((H, W)) < share
    v, u = np.nonzero(ok)
    n = len(v)
    zz = smooth[v, u] + gsd * (np.where(label[v, u] == 1, noise, 0.7) * rng.standard_normal(n) + correlated[v, u])
    zz = zz + (rng.random(n) < outliers) * gsd * rng.uniform(8, 50, n) * rng.choice([-1, 1], n)
    du, dv = rng.uniform(-0.5, 0.5, (2, n))
    X = np.stack([(u + du - cam.K[0, 2]) / cam.K[0, 0] * zz, (v + dv - cam.K[1, 2]) / cam.K[1, 1] * zz, zz], 1)
    N = np.stack([gaussian_filter(normal[..., k], blur)[v, u] for k in range(3)], 1) + 0.03 * rng.standard_normal(
        (n, 3)
    )
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    return (X - cam.t) @ cam.R, N @ cam.R, gray[v, u]


def from_views(views, shares, keep, noise, gsd, rng, blur=3.0):
    """views = list of (truth, gray image); shares = share of each view's pixels that become points."""
    parts = [from_view(t, g, {1: keep, 2: 0.95}, noise, gsd, rng, blur, s) for (t, g), s in zip(views, shares)]
    P, N, G = (np.concatenate([p[k] for p in parts]) for k in range(3))
    order = rng.permutation(len(P))
    return P[order], N[order], G[order]
