"""Pinhole cameras.  Camera frame: x right, y down, z forward (OpenCV, COLMAP).  K uses OpenCV pixel coordinates, in which the
center of the top-left pixel is (0, 0); COLMAP files have +0.5."""

import numpy as np

SENSOR_WIDTH_MM = 22.3


def look_at(center, target, up, roll_deg):
    """R, t of x_cam = R x_world + t."""
    f = (target - center) / np.linalg.norm(target - center)
    r = np.cross(f, up)
    r /= np.linalg.norm(r)
    a = np.radians(roll_deg)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    R = turn @ np.stack([r, np.cross(f, r), f])
    return R, -R @ center


class Camera:
    def __init__(self, width, height, focal_mm, offset, R, t, sensor_mm=SENSOR_WIDTH_MM):
        self.W, self.H, self.R, self.t, self.focal_mm = width, height, R, t, focal_mm
        f = focal_mm / sensor_mm * width
        self.K = np.array([[f, 0, width / 2 - 0.5 + offset[0]], [0, f, height / 2 - 0.5 + offset[1]], [0, 0, 1.0]])

    @property
    def center(self):
        return -self.R.T @ self.t

    def project(self, X):
        p = np.asarray(X) @ self.R.T + self.t
        return p[..., :2] / p[..., 2:] * [self.K[0, 0], self.K[1, 1]] + self.K[:2, 2], p[..., 2]

    def rays(self):
        """Rays through the pixel centers in the camera frame, with depth 1 along the optical axis; (H*W, 3)."""
        u, v = np.meshgrid(np.arange(self.W), np.arange(self.H))
        d = np.stack([(u - self.K[0, 2]) / self.K[0, 0], (v - self.K[1, 2]) / self.K[1, 1], np.ones_like(u, float)], -1)
        return d.reshape(-1, 3)

    def as_json(self):
        return dict(
            width=self.W,
            height=self.H,
            K=self.K.tolist(),
            R_world_to_cam=self.R.tolist(),
            t_world_to_cam=self.t.tolist(),
            centre_world=self.center.tolist(),
        )


def station_camera(spec, size, rng):
    """spec: target, dist, focal_mm, roll, and either direction (from the target to the camera) or tilt (degrees about x and y, from +z)."""
    target = np.array(spec["target"], float)
    if "direction" in spec:
        d = np.array(spec["direction"], float)
    else:
        ax, ay = np.radians(spec["tilt"])
        d = np.array([np.sin(ay), -np.sin(ax), 1.0])
    C = target + d / np.linalg.norm(d) * spec["dist"]
    R, t = look_at(C, target + rng.uniform(-1, 1, 3) * spec["dist"] * 2e-3, np.array([0, 1.0, 0]), spec["roll"])
    W, H = size
    return Camera(
        W, H, spec["focal_mm"], 0.004 * W * rng.uniform(-1, 1, 2), R, t, spec.get("sensor_mm", SENSOR_WIDTH_MM)
    )


def convergent_photos(spec, target, size, rng):
    """n cameras on two cones about +z (two thirds on the outer one); every fifth camera is rolled by 90 degrees."""
    W, H = size
    n, offset, out = spec["n"], 0.005 * size[0] * rng.uniform(-1, 1, 2), []
    outer = n * 2 // 3
    for k in range(n):
        azimuth = 2 * np.pi * (k / outer if k < outer else (k - outer + 0.5) / (n - outer))
        angle = np.radians(spec["angle"] * (1 if k < outer else 0.45) + rng.uniform(-2, 2))
        d = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
        C = target + d * spec["dist"] * rng.uniform(0.97, 1.08)
        aim = target + rng.uniform(-1, 1, 3) * spec["dist"] * 0.01
        R, t = look_at(C, aim, np.array([0, 1.0, 0]), rng.normal(0, 3) + (90 if k % 5 == 4 else 0))
        out.append(Camera(W, H, spec["focal_mm"], offset, R, t))
    return out


def around(azimuth_deg, elevation_deg):
    """Direction from an upright object (axis +y) to a camera; azimuth 0 = +z."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])


def ring_photos(spec, target, size, rng):
    """n cameras around an upright object, which take the elevations in turn."""
    W, H = size
    offset, out = 0.005 * W * rng.uniform(-1, 1, 2), []
    for k in range(spec["n"]):
        el = spec["elevations"][k % len(spec["elevations"])] + rng.uniform(-2, 2)
        C = target + around(360 / spec["n"] * k + rng.uniform(-4, 4), el) * spec["dist"] * rng.uniform(0.97, 1.05)
        R, t = look_at(
            C, target + rng.uniform(-1, 1, 3) * spec["dist"] * 0.006, np.array([0, 1.0, 0]), rng.normal(0, 2)
        )
        out.append(Camera(W, H, spec["focal_mm"], offset, R, t))
    return out


def quaternion(R):
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]]
    return -q if q[0] < 0 else q


def write_colmap(folder, images, distortion=None):
    """COLMAP text model; images = list of (file name, Camera, camera number); distortion = {number: (k1, k2, p1, p2)}."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = {}
    for _, c, i in images:
        cameras.setdefault(i, c)
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]  (COLMAP pixel convention: center of first pixel = 0.5,0.5)"]
    for i, c in cameras.items():
        more = "".join(f" {v:.8g}" for v in distortion[i]) if distortion else ""
        lines.append(
            f"{i} {'OPENCV' if distortion else 'PINHOLE'} {c.W} {c.H} {c.K[0, 0]:.6f} {c.K[1, 1]:.6f} {c.K[0, 2] + 0.5:.6f} {c.K[1, 2] + 0.5:.6f}{more}"
        )
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n")
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for k, (name, c, i) in enumerate(images):
        q, t = quaternion(c.R), c.t
        lines += [
            f"{k + 1} " + " ".join(f"{v:.10f}" for v in q) + " " + " ".join(f"{v:.8f}" for v in t) + f" {i} {name}",
            "",
        ]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "points3D.txt").write_text("# empty: ground-truth poses only\n")
