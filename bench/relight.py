"""100 environments × 3 materials × 2 views: the engine of fixed views, the loop over renders, and Mitsuba.

    DRJIT_LIBLLVM_PATH=/path/to/libLLVM-19.so python bench/relight.py [-o bench/results/relight.json]
        [--environments 100] [--renders 3] [--no-rival]

The environments are turns of two maps, a hard sun and an interior of many lamps; the mesh is the Stanford bunny (72,023
vertices) at 512 × 512. What is timed is all that the job needs once the files are read: camera rays, visibility, the
resampling of every turned map, transport, products and hard light.

Errors are relative RMSE over sampled pixels, stratified by brightness, against float64 (bench/exact.py), of frames
whose map is turned by half a turn or not at all, which the reference can do exactly (a shift of columns). The loop's
time is the mean of a few of its renders at 2 × 2 points a pixel times the number of frames, with each one's error and
the engine's on the same pixels beside it: where the loop's is larger, it would need more points still. Mitsuba's is
that of the samples a pixel at which it errs as much as the engine on the same pixels, along a straight line of the
logarithms between measured steps and, beyond the last, by the slope that favours it. Both are extrapolated. The second
way for hard light, leaving it in the grid, is `hard_off`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scenes
from exact import Exact

from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.engine_choice import choose_engine
from prtcl.scene.frames_looks import Looks
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import Scene, read_environment
from prtcl.scene.view_points import ViewPoints
from prtcl.transport.fixed_view import FixedView, rays_for

MESH, MAPS = "stanford_bunny", ("modern_buildings_2", "st_fagans_interior")
LEVELS, PEAK_SIDE = 5, 2
STEPS = (16, 64, 256)
"""Mitsuba's samples a pixel."""


def reference(scene_of, cameras, samples, maps, materials, points, turns=(False, True)):  # type: ignore[no-untyped-def]
    """{(map, turned): (pixels, materials, 2 halves, 3)} of sampled pixels (view, pixel)."""
    mesh, tracer = scene_of
    found = {}
    for name, environment in maps.items():
        for turned in turns:
            image = (
                np.roll(environment.image, environment.image.shape[1] // 2, axis=1)
                if turned
                else environment.image
            )
            exact = Exact(Environment(image), tracer, LEVELS, PEAK_SIDE)
            total = np.zeros((len(samples), len(materials), 2, 3))
            for row, (view, pixel) in enumerate(samples):
                for half in (0, 1):
                    rng, count = np.random.default_rng([pixel, half]), points // 2
                    hits = shoot(
                        tracer, cameras[view], np.full(count, pixel), 4096 * (half + 1) + np.arange(count)
                    )
                    at = pixel_points(mesh, tracer, hits, np.zeros(len(hits.ray), dtype=np.int64))
                    for i in range(len(at)):
                        axes, towards = at.frames[i].astype(np.float64), at.views[i].astype(np.float64)
                        places = tuple(rng.random((2, 4**LEVELS)))
                        total[row, :, half] += exact.radiance(
                            at.origins[i : i + 1], axes, towards, materials, places
                        )
                    total[row, :, half] /= max(1, len(at))
            found[name, turned] = total
    return found


def rmse(got, truth):  # type: ignore[no-untyped-def]
    return float(np.sqrt(((got - truth) ** 2).mean()) / truth.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--environments", type=int, default=100)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--pixels", type=int, default=48, help="sampled for the error")
    parser.add_argument("--points", type=int, default=256, help="of the reference, a pixel")
    parser.add_argument("--renders", type=int, default=3, help="of the loop, to extrapolate from")
    parser.add_argument("--no-rival", action="store_true")
    options = parser.parse_args()
    scenes.require_data()
    command = f"python bench/relight.py --pixels {options.pixels} --points {options.points}"
    started, device = time.perf_counter(), Device()
    mesh = read_mesh(scenes.mesh_path(MESH))
    tracer = Tracer(mesh.vertices, mesh.faces)
    size = (options.size, options.size)
    front = Camera.framing(mesh.bounds, size=size)
    eye = 2 * np.array(front.target) - np.array(front.eye)
    eye[1] = front.eye[1]
    cameras = [front, Camera.framing(mesh.bounds, eye=tuple(eye.tolist()), size=size)]
    maps = {name: read_environment(scenes.environment_path(name))[0] for name in MAPS}
    each = options.environments // len(maps)
    jobs = [(name, 360.0 * i / each) for name in maps for i in range(each)]
    environments = [replace(maps[name], rotate=turn) for name, turn in jobs]
    looks = [[Material.parse(spec)] for spec in scenes.MATERIALS]
    rays = rays_for(look[0] for look in looks)
    frames = len(environments) * len(looks) * len(cameras)
    result = {
        "device": device.name,
        "mesh": MESH,
        "size": size,
        "frames": frames,
        "materials": scenes.MATERIALS,
    }

    # Compiles the kernels as well.
    result["choice"] = choose_engine(mesh, Looks(scenes.MATERIALS, mesh), device, front, environments).reason
    print(result["choice"], flush=True)

    rows, sampled, ours, off = [], [], [], []
    for view, camera in enumerate(cameras):
        device.profile.reset()
        begin = time.perf_counter()
        seen = ViewPoints.of(mesh, tracer, camera, one_material=True)
        shot = time.perf_counter()
        engine = FixedView(device, tracer, seen.points, seen.pixel, rays=rays)
        ready = time.perf_counter()
        radiance = engine.radiance(environments, looks)
        done = time.perf_counter()
        rows.append(
            {
                "pixels": len(engine), "points": len(seen.points), "camera_rays": shot - begin,
                "visibility": ready - shot, "radiance": done - ready, "total": done - begin,
                "host": device.profile.host_seconds(), "device": device.profile.device_seconds(),
            }
        )  # fmt: skip
        print(rows[-1], flush=True)
        grey = radiance[0].sum(axis=(0, 2))
        rng = np.random.default_rng(7)
        strata = np.array_split(np.argsort(grey, kind="stable"), options.pixels // 2)
        chosen = np.array([rng.choice(stratum) for stratum in strata])
        sampled += [(view, int(seen.seen[row])) for row in chosen]
        ours.append(radiance[:, :, chosen])
        few = [environments[i] for i in range(0, len(environments), each)]
        small = np.isin(seen.pixel, seen.seen[chosen])
        off.append(
            FixedView(device, tracer, seen.points[small], seen.pixel[small], rays=rays).radiance(
                few, looks, hard="off"
            )[:, :, np.argsort(np.argsort(chosen))]
        )
    seconds = sum(row["total"] for row in rows)
    result |= {"views": rows, "seconds": seconds, "frames_per_second": frames / seconds}
    print(f"{frames} frames in {seconds:.1f} s: {frames / seconds:.2f} frames/s", flush=True)

    got, left = np.concatenate(ours, axis=2), np.concatenate(off, axis=2)
    begin = time.perf_counter()
    materials = [look[0].reference() for look in looks]
    halves = reference((mesh, tracer), cameras, sampled, maps, materials, options.points)
    truth = {key: value.mean(axis=2) for key, value in halves.items()}
    print(f"reference: {time.perf_counter() - begin:.0f} s", flush=True)
    errors = []
    for n, name in enumerate(maps):
        for m, spec in enumerate(scenes.MATERIALS):
            noise = [halves[name, t][:, m] for t in (False, True)]
            pair = [n * each, n * each + each // 2]
            stacked = np.stack([truth[name, t][:, m] for t in (False, True)])
            errors.append(
                {
                    "environment": name, "material": spec, "relative_rmse": rmse(got[m, pair], stacked),
                    "bias": float(got[m, pair].mean() / stacked.mean() - 1),
                    "reference_noise": float(
                        np.sqrt(np.mean([((h[:, 0] - h[:, 1]) ** 2).mean() / 4 for h in noise])) / stacked.mean()
                    ),
                    "hard_off": rmse(left[m, n], truth[name, False][:, m]),
                }
            )  # fmt: skip
            print(errors[-1], flush=True)
    result["errors"] = errors

    at = np.array([row for row, (view, _) in enumerate(sampled) if view == 0])
    pixel = np.array([p for _, p in sampled])
    if options.renders:
        result["loop"] = loop_rows(
            mesh, maps, looks, front, options.renders, at, pixel, truth, got, each, frames, seconds, device
        )
    if not options.no_rival:
        scenes.save(options.output, command=f"{command} --no-rival", **result)
        result["rival"] = rival_rows(mesh, maps, looks, front, at, pixel, truth, got, each, frames, seconds)
    result["bench_seconds"] = time.perf_counter() - started
    print(f"all: {result['bench_seconds']:.0f} s")
    scenes.save(options.output, command=command, **result)


def loop_rows(  # type: ignore[no-untyped-def]
    mesh, maps, looks, camera, renders, at, pixel, truth, got, each, frames, seconds, device
):
    """`Scene.render` of the first view at 2 × 2 points a pixel."""
    rows = []
    for number in range(renders):
        n, m = number % len(maps), number % len(looks)
        name = list(maps)[n]
        scene = Scene(mesh, maps[name], looks[m][0], camera, device=device)
        begin = time.perf_counter()
        image = scene.render(samples=2).image.reshape(-1, 4)
        took = time.perf_counter() - begin
        wanted = truth[name, False][at, m]
        colour = image[pixel[at], :3] / np.maximum(image[pixel[at], 3:], 1e-9)
        rows.append(
            {
                "environment": name, "material": looks[m][0].spec, "seconds": took,
                "relative_rmse": rmse(colour, wanted), "engine_relative_rmse": rmse(got[m, n * each][at], wanted),
            }
        )  # fmt: skip
        print("Scene.render", rows[-1], flush=True)
    mean = float(np.mean([row["seconds"] for row in rows]))
    print(
        f"the loop, extrapolated: {mean * frames:.0f} s, {mean * frames / seconds:.0f} times as long",
        flush=True,
    )
    return {"renders": rows, "seconds_extrapolated": mean * frames, "speedup": mean * frames / seconds}


def rival_rows(mesh, maps, looks, camera, at, pixel, truth, got, each, frames, seconds):  # type: ignore[no-untyped-def]
    """Mitsuba's time at our error on the pixels of the first view, for every map and material."""
    from rival import Rival

    rows = []
    for n, (name, environment) in enumerate(maps.items()):
        for m, look in enumerate(looks):
            wanted = truth[name, False][at, m]
            ours = rmse(got[m, n * each][at], wanted)
            rival, steps = Rival(mesh, environment, look[0], camera), []
            for spp in STEPS:
                rival.render(spp)  # compiles
                begin = time.perf_counter()
                image = rival.render(spp, seed=1).reshape(-1, 4)
                took = time.perf_counter() - begin
                share = np.maximum(image[pixel[at], 3:], 1e-9)
                steps.append((spp, took, rmse(image[pixel[at], :3] / share, wanted)))
                if steps[-1][2] < ours:
                    break
            # Beyond the last step by the square root of the samples or, if that is faster, as between the last two.
            if steps[-1][2] >= ours:
                fall = max(0.5, np.log(steps[-2][2] / steps[-1][2]) / np.log(steps[-1][0] / steps[-2][0]))
                time_needed = float(steps[-1][1] * (steps[-1][2] / ours) ** (1 / fall))
            elif len(steps) == 1:
                time_needed = steps[0][1]
            else:
                (_, t0, e0), (_, t1, e1) = steps[-2:]
                share = np.log(e0 / ours) / np.log(e0 / e1)
                time_needed = float(np.exp(np.log(t0) + share * np.log(t1 / t0)))
            rows.append(
                {
                    "environment": name, "material": look[0].spec, "relative_rmse": ours, "seconds": time_needed,
                    "steps": steps,
                }
            )  # fmt: skip
            print("Mitsuba", rows[-1], flush=True)
    mean = float(np.mean([row["seconds"] for row in rows]))
    print(f"Mitsuba, extrapolated: {mean * frames:.0f} s, {mean * frames / seconds:.0f} times as long")
    return {"frames": rows, "seconds_extrapolated": mean * frames, "speedup": mean * frames / seconds}


if __name__ == "__main__":
    main()
