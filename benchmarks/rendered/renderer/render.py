#!/usr/bin/env python3
"""Renders one scene: polarized stations, photographs, exact truth, a coarse cloud and station files. See README.md.

python render.py --scene coin --style dev --out out/coin
"""

import argparse
import importlib.util
import time
from pathlib import Path

import cameras
import clouds
import cv2
import noise
import numpy as np
import outputs
import stations
import tracer
from scenes import SCENES

mi = tracer.mi


def size(text):
    return tuple(map(int, text.lower().split("x")))


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scene", required=True, choices=list(SCENES))
    p.add_argument("--style", default="dev")
    p.add_argument("--styles", type=Path, help="Python file whose STYLES = {scene: {style: {...}}} adds styles")
    p.add_argument("--out", type=Path, help="default out/STYLE/SCENE")
    p.add_argument("--seed", type=int, help="other random numbers than the style's")
    p.add_argument("--size", type=size, help="of the polarized images, e.g. 600x400")
    p.add_argument("--view-size", type=size)
    p.add_argument("--views", type=int, help="number of photographs")
    p.add_argument("--spp", type=int, help="samples per pixel of the Stokes images")
    p.add_argument("--view-spp", type=int, default=24)
    p.add_argument("--quality", type=float, default=1.0, help="mesh density; 0.3 for a quick look")
    p.add_argument(
        "--no-components", action="store_true", help="leave out gt/components.npz (saves a third of the time)"
    )
    p.add_argument(
        "--noisy", choices=["all", "first", "none"], default="all", help="which stations get single noisy frames too"
    )
    a = p.parse_args()
    if a.styles:
        spec = importlib.util.spec_from_file_location("more_styles", a.styles)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        for name, more in module.STYLES.items():
            SCENES[name].STYLES.update(more)
    if a.style not in SCENES[a.scene].STYLES:
        p.error(f"{a.scene} has the styles {', '.join(SCENES[a.scene].STYLES)}")
    return a


def render_station(scene, objects, sc, cam, spp, seed, with_components):
    """Truth and Stokes images, exposed so that 99.5 % of the object is below 85 % of the full well."""
    truth = tracer.raycast(scene, objects, sc, cam)
    options = dict(depth=sc.get("depth", 4), hide=sc.get("hide_lights", False))
    S, error = tracer.render_stokes(scene, cam, spp, seed=seed, **options)
    obj = truth["label"] == 1
    gain = 0.85 / np.quantile((0.5 * (S[..., 0] + np.hypot(S[..., 1], S[..., 2])))[obj], 0.995)
    S, error, parts = S * gain, error * gain, None
    if with_components and all(m["bsdf"]["type"] == "pplastic" for m in sc["meshes"] if m["label"] == 1):
        parts = []
        for k, what in enumerate(("diffuse_reflectance", "specular_reflectance")):  # specular part, diffuse part
            old = tracer.set_object(scene, what)
            parts.append(tracer.render_stokes(scene, cam, max(72, spp // 4), seed=seed + 1 + k, **options)[0] * gain)
            tracer.set_object(scene, what, old)
    floor = dict(
        path_s0=float(np.median(error[obj][:, 0])),
        path_s1_s2=float(np.median(error[obj][:, 1:])),
        single_frames_s1_s2=float(np.median(noise.stokes_noise(S)[obj])),
        unit="full well, median over the object",
    )
    return truth, S, parts, gain, floor


def main():
    a, start = arguments(), time.time()
    module = SCENES[a.scene]
    style = dict(module.STYLES[a.style])
    seed = a.seed if a.seed is not None else style["seed"]
    out = a.out or Path("out") / a.style / a.scene
    sc = module.scene(style, np.random.default_rng(seed), a.quality)
    W, H = a.size or sc.get("size", (600, 400))
    VW, VH = a.view_size or sc.get("view_size", (900, 600))
    spp = a.spp or sc.get("spp", 144)
    took = dict(geometry=time.time() - start)

    def clock(name, since):
        took[name] = took.get(name, 0) + time.time() - since

    t = time.time()
    scene, objects = tracer.build(sc)
    clock("scene", t)

    rng = np.random.default_rng(seed + 1)  # so that poses do not depend on the geometry
    specs = sc["stations"]
    cams = [cameras.station_camera(s, (W, H), rng) for s in specs]
    center = np.array(specs[0]["target"], float)
    views = dict(sc["views"], **(dict(n=a.views) if a.views else {}))
    photo_cams = (cameras.ring_photos if "elevations" in views else cameras.convergent_photos)(
        views, center, (VW, VH), rng
    )

    sensor_rng, several = np.random.default_rng(seed + 2), len(specs) > 1
    lens, done = sc.get("distortion"), []
    for k, cam in enumerate(cams):
        folder = out / f"st{k}" if several else out
        t = time.time()
        truth, S, parts, gain, floor = render_station(scene, objects, sc, cam, spp, seed + 100 * k, not a.no_components)
        clock("stokes", t)
        outputs.truth(folder, truth, S)
        if parts:
            outputs.components(folder, S, *parts, truth["label"])
        sets = dict(lownoise=outputs.polarized_set(folder, "lownoise", S, 16, sensor_rng))
        if a.noisy == "all" or (a.noisy == "first" and k == 0):
            sets["noisy_misreg"] = outputs.polarized_set(
                folder, "noisy_misreg", S, 1, sensor_rng, noise.misregistration(sensor_rng, W, H)
            )
        if sc.get("jpeg"):
            sets["jpeg8"] = outputs.polarized_set(
                folder, "jpeg8", S, 1, sensor_rng, noise.misregistration(sensor_rng, W, H, 0.5), True
            )
        if lens:
            maps = noise.distort_maps(cam.K, np.array(lens["station"]), W, H)
            SD = np.stack(
                [cv2.remap(S[..., i], *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101) for i in range(3)], -1
            )
            sets["distorted"] = dict(
                outputs.polarized_set(folder, "distorted", SD, 16, sensor_rng), dist_k1k2p1p2=lens["station"]
            )
        obj = truth["label"] == 1
        if obj.mean() < 0.95:
            outputs.png(folder / "mask.png", (obj * 255).astype(np.uint8))
        e8 = min(0.55, 0.9 / np.quantile(S[..., 0], 0.98))
        gray = noise.srgb8(noise.sensor_dn(S[..., 0] * e8, sensor_rng, 4) / noise.WHITE_DN)
        image = f"st{k}.jpg" if several else "station.jpg"
        outputs.jpg(out / "views" / image, gray, 94)
        if lens:
            outputs.jpg(out / "views_distorted" / image, noise.srgb8(np.clip(SD[..., 0] * e8, 0, 1)), 94)
        done.append(
            dict(
                folder=folder,
                image=image,
                truth=truth,
                gray=gray,
                sets=sets,
                floor=floor,
                gain=gain,
                gsd=float(np.median(truth["z"][obj]) / cam.K[0, 0]),
            )
        )
        print(
            f"{folder.name}: {int(obj.sum())} object px, GSD {done[-1]['gsd']:.4f} mm, {time.time() - t:.0f} s, noise {floor}",
            flush=True,
        )

    t, exposure, photos, shared = (
        time.time(),
        None,
        [],
        dict(hide=sc.get("hide_lights", False), depth=sc.get("view_depth", 3)),
    )
    for k, cam in enumerate(photo_cams):
        I = tracer.render_photo(scene, cam, a.view_spp, seed=seed + 1000 + k, **shared)
        exposure = exposure or 0.9 / np.quantile(I[I > 0], 0.97)
        name = f"view_{k:02d}.jpg"
        photo = lambda J, exposure=exposure: noise.srgb8(
            noise.sensor_dn(np.clip(J * exposure, 0, 1), sensor_rng, 2) / noise.WHITE_DN
        )
        photos.append((name, cam, photo(I)))
        outputs.jpg(out / "views" / name, photos[-1][2])
        if lens:
            maps = noise.distort_maps(cam.K, np.array(lens["views"]), VW, VH)
            outputs.jpg(
                out / "views_distorted" / name,
                photo(cv2.remap(I, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)),
            )
    clock("views", t)
    model = [(n, c, 1) for n, c, _ in photos] + [(d["image"], c, 2 + k) for k, (d, c) in enumerate(zip(done, cams))]
    cameras.write_colmap(out / "gt_sparse", model)
    if lens:
        cameras.write_colmap(out / "gt_sparse_distorted", model, {1: lens["views"], 2: lens["station"]})

    cloud_rng, gsd, mvs = np.random.default_rng(seed + 3), float(np.median([d["gsd"] for d in done])), sc["mvs"]
    if several:  # points from every second photo
        seen = [(tracer.raycast(scene, objects, sc, c), g) for _, c, g in photos[::2]]
        shares = [mvs.get("share", 1 / 16)] * len(seen)
    else:  # points from the station's view and two of the photos
        seen = [(done[0]["truth"], done[0]["gray"])]
        seen += [
            (tracer.raycast(scene, objects, sc, photos[k][1]), photos[k][2]) for k in (0, len(photos) * 2 // 3 // 2)
        ]
        shares = [1 / 8, 1 / 40, 1 / 40]
    cloud = clouds.from_views(seen, shares, mvs["keep"], mvs["noise"], gsd, cloud_rng)
    outputs.cloud_ply(out / "dense/mvs_cloud.ply", *cloud)
    counts = dict(points=len(cloud[0]))
    if mvs["keep"] < 0.9:
        cloud = clouds.from_views(seen, shares, 0.96, 0.7, gsd, cloud_rng)
        outputs.cloud_ply(out / "dense/mvs_cloud_good.ply", *cloud)
        counts["points_good"] = len(cloud[0])
    if "truth_mesh" in sc:
        outputs.mesh_ply(out / "gt/mesh.ply", *sc["truth_mesh"])

    took["total"] = time.time() - start
    points, names = sc["points"], list(sc["points"])
    common = dict(
        scene=a.scene,
        style=a.style,
        seed=seed,
        units="mm",
        generator=f"mitsuba {mi.__version__} {mi.variant()}",
        spp=spp,
        size=[W, H],
        angles_deg=noise.ANGLES,
        angle_convention=dict(
            zero="image +x (right)",
            positive="counter-clockwise as displayed (towards image up)",
            formula="I=0.5*(s0+s1*cos(2a)+s2*sin(2a))",
            transmission_axis_px="(cos a, -sin a) with y down",
        ),
        pixel_convention="K: OpenCV, center of top-left pixel=(0,0); COLMAP files: +0.5",
        camera_frame="x right, y down, z forward; normals towards the camera have nz<0",
        depth="z along the optical axis [mm], 0 = none",
        views=[dict(name=n, **c.as_json()) for n, c, _ in photos],
        distortion=dict(model="OpenCV k1,k2,p1,p2", **lens) if lens else None,
        material=sc["material"],
        lights=sc["light_meta"],
        scale_distances_mm={
            f"{names[i]}-{names[j]}": float(np.linalg.norm(np.subtract(points[names[i]], points[names[j]])))
            for i in range(len(names))
            for j in range(i)
        },
        labels={"0": "background", "1": "object", "2": "textured support board"},
        materials=sc.get("materials", {"1": "object"}),
        dense=dict(
            counts,
            blur_px=3.0,
            noise_gsd=mvs["noise"],
            keep=mvs["keep"],
            outliers=0.03,
            note="mvs_cloud.ply = plausible stereo result; mvs_cloud_good.ply = as if stereo had worked",
        ),
        photos_self_calibrate=sc.get("photos_self_calibrate", False),
        timing_s={k: round(v, 1) for k, v in took.items()},
    )
    folders = []
    for k, (d, cam, spec) in enumerate(zip(done, cams, specs)):
        to_light = [(cam.R @ np.array(s)).tolist() for s in sc["light_meta"].get("dir_to_light_world", [])]
        meta = dict(
            common,
            name=f"{a.scene} {k}" if several else a.scene,
            shared_folder="../" if several else "",
            station_image=d["image"],
            gsd_mm=d["gsd"],
            station=cam.as_json(),
            pol_sets=d["sets"],
            exposure_gain=d["gain"],
            stokes_noise=d["floor"],
            sensor=dict(
                width_mm=spec.get("sensor_mm", cameras.SENSOR_WIDTH_MM),
                focal_mm=spec["focal_mm"],
                full_well_e=noise.FULL_WELL_E,
                read_noise_e=noise.READ_NOISE_E,
                white_level_dn=noise.WHITE_DN,
                stokes_unit="1.0 = full well (DN 16383) in an unattenuated image; a polarized image is about s0/2",
            ),
            lights=dict(sc["light_meta"], dir_to_light_cam=to_light),
            flat_patches=outputs.flat_patches(sc["flat"], d["truth"]),
            scale_points={
                n: dict(world=list(map(float, p)), station_px=cam.project(np.array(p))[0].tolist())
                for n, p in points.items()
            },
        )
        outputs.text(d["folder"] / "meta.json", meta)
        stations.write_all(d["folder"], meta)
        folders.append(d["folder"].name)
        print(
            d["folder"],
            "patches",
            [
                (p["name"], p["box_xyxy"], round(p["zenith_deg"], 1), p["gt_plane_rmse_mm"])
                for p in meta["flat_patches"]
            ],
            flush=True,
        )
    if several:
        stations.write_object(out / "object.toml", a.scene, folders)
    print(a.scene, a.style, counts, common["timing_s"], flush=True)


if __name__ == "__main__":
    main()
