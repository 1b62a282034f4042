"""The sensor: shot and read noise, quantization, gamma; misregistration of the polarized images; lens distortion."""

import cv2
import numpy as np

ANGLES = [0, 30, 60, 90, 120, 150]
FULL_WELL_E, READ_NOISE_E, WHITE_DN = 20000.0, 8.0, 16383


def polarized(S, angle_deg):
    """Intensity behind a polarizer at this angle: 0 = image +x, positive = counter-clockwise as displayed."""
    a = np.radians(angle_deg)
    return 0.5 * (S[..., 0] + S[..., 1] * np.cos(2 * a) + S[..., 2] * np.sin(2 * a))


def sensor_dn(I, rng, frames):
    """Sensor values, DN 0..16383 (uint16) in steps of 4 DN, of the average of `frames` exposures; I in units of the full well."""
    e, out = np.clip(I, 0, None) * FULL_WELL_E, 0
    if frames <= 4:
        for _ in range(frames):
            out = out + np.clip(rng.poisson(e) + rng.normal(0, READ_NOISE_E, e.shape), 0, FULL_WELL_E) / frames
    else:
        out = np.clip(e + rng.standard_normal(e.shape) * np.sqrt((e + READ_NOISE_E**2) / frames), 0, FULL_WELL_E)
    return np.clip(np.round(out / FULL_WELL_E * WHITE_DN / 4) * 4, 0, WHITE_DN).astype(np.uint16)


def stokes_noise(S):
    """Standard deviation of S1 (and S2) from six single frames, in units of the full well."""
    e = np.clip(S[..., 0], 0, None) / 2 * FULL_WELL_E
    return np.sqrt(e + READ_NOISE_E**2) / FULL_WELL_E * np.sqrt(4 / len(ANGLES) * 2)


def srgb8(I):
    I = np.clip(I, 0, 1)
    return np.round(255 * np.where(I <= 0.0031308, 12.92 * I, 1.055 * I ** (1 / 2.4) - 0.055)).astype(np.uint8)


def misregistration(rng, W, H, amplitude=1.0):
    """2x3 matrices M_k from pixels of the reference image (0 degrees) to pixels of image k. Up to ~1.5 px, 0.03 degrees."""
    out, phase = [], rng.uniform(0, 6.28)
    center = np.array([(W - 1) / 2, (H - 1) / 2])
    for angle in ANGLES:
        if angle == 0:
            out.append(np.eye(2, 3))
            continue
        a = np.radians(angle) + phase
        shift = amplitude * (
            0.7 * np.array([np.cos(a) - np.cos(phase), np.sin(a) - np.sin(phase)]) + rng.uniform(-0.35, 0.35, 2)
        )
        r, s = np.radians(rng.uniform(-0.03, 0.03)), 1 + rng.uniform(-2e-4, 2e-4)
        A = s * np.array([[np.cos(r), -np.sin(r)], [np.sin(r), np.cos(r)]]) + np.array(
            [[0, rng.uniform(-1e-4, 1e-4)], [0, 0]]
        )
        out.append(np.hstack([A, (center + shift - A @ center)[:, None]]))
    return out


def moved(I, M):
    return cv2.warpAffine(I, M, I.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)


def distort_maps(K, dist, W, H):
    """For every pixel of the distorted image the coordinates of the pinhole image that it shows (OpenCV k1, k2, p1, p2)."""
    u, v = np.meshgrid(np.arange(W, dtype=np.float64), np.arange(H, dtype=np.float64))
    p = np.stack([u, v], -1).reshape(-1, 1, 2)
    if hasattr(cv2, "undistortPointsIter"):
        p = cv2.undistortPointsIter(p, K, dist, None, K, (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12))
    else:
        p = cv2.undistortPoints(p, K, dist, P=K)
    p = p.reshape(H, W, 2).astype(np.float32)
    return p[..., 0], p[..., 1]
