"""`--error`: what is asked, predicted and true, and how long it takes beside the best fixed setting.

    DRJIT_LIBLLVM_PATH=/path/to/libLLVM-19.so python bench/plan.py [-o bench/results/plan.json] [--size 320x272]

Scenes are those of ../shared/data (`bench/scenes.py`); the first half was looked at while the planner was made, the
second was not. Truth is Mitsuba 3's, in two halves of `--spp` samples each: the mean product of an image's differences
from the two is the square of its error, without their noise. A fixed setting is a number of rays and either an error
that the film's own estimate is refined to or a number of points that all pixels get; the best is the fastest whose
true error is no more than what was asked. Times are the wall's, of `Scene.render`, pilot and audits included; the
scene's BVH and the split of its light, the same for all, are made before.

All fixed settings take most of an hour. `--beside` takes the best ones that such a run found and times these alone
again, so that a plan and what it is held against are of one run.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import scenes
from rival import Rival

from prtcl.apps.arguments import size
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.scene import Scene, read_environment

LOOKED_AT = (
    ("nefertiti", "modern_buildings_2", "ggx:alpha=0.3,eta=0.2,k=3.0"),
    ("stanford_bunny", "st_fagans_interior", "ggx:alpha=0.3,eta=0.2,k=3.0"),
    ("bob", "st_peters_square_night", "lambert:albedo=0.5"),
    ("nefertiti", "modern_buildings_2", "ggx:alpha=0.1,eta=0.2,k=3.0"),
)
UNSEEN = (
    ("koala", "venice_sunset", "lambert:albedo=0.5"),
    ("spot", "potsdamer_platz", "ggx:alpha=0.3,eta=0.2,k=3.0"),
    ("bob_342k", "kloppenheim_05", "ggx:alpha=0.1,eta=0.2,k=3.0"),
    ("koala", "studio_small_03", "ggx:alpha=0.2,eta=0.2,k=3.0"),
)
ERRORS = (0.05, 0.02, 0.01)
RAYS = (3, 4, 2)
AIMS = (0.08, 0.056, 0.04, 0.028, 0.02, 0.014)
SAMPLES = (1, 2, 4)


class Truth:
    """Mitsuba's picture of a scene, twice."""

    def __init__(self, scene: Scene, spp: int) -> None:
        rival = Rival(scene.mesh, scene.environment, scene.materials[0], scene.camera)
        self.halves = [rival.render(spp, seed) for seed in (1, 2)]

    def error(self, image: np.ndarray) -> float:
        """Relative RMSE over the pixels that either covers."""
        a, b = self.halves
        covered = (image[..., 3] > 0) | (a[..., 3] > 0) | (b[..., 3] > 0)
        off = [(image - half)[covered][:, :3].astype(np.float64) for half in (a, b)]
        mean = float((a + b)[covered][:, :3].mean()) / 2.0
        return float(np.sqrt(max(0.0, (off[0] * off[1]).mean()))) / mean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--size", type=size, default=(320, 272))
    parser.add_argument("--spp", type=int, default=4096)
    parser.add_argument("--errors", type=float, nargs="+", default=ERRORS)
    parser.add_argument("--only", type=int, nargs="+", help="numbers of scenes, from 0")
    parser.add_argument("--no-fixed", action="store_true", help="plans alone")
    parser.add_argument(
        "--beside", type=Path, help="a result whose best fixed settings alone are timed again"
    )
    options = parser.parse_args()
    scenes.require_data()
    device, rows, frontier = Device(), [], []
    chosen = [*LOOKED_AT, *UNSEEN]
    for number in options.only or range(len(chosen)):
        mesh, environment, spec = chosen[number]
        row, points = one_scene(device, mesh, environment, spec, options)
        for own in row:
            own.update(mesh=mesh, environment=environment, material=spec, unseen=number >= len(LOOKED_AT))
            print(line(own), flush=True)
        rows += row
        frontier.append({"mesh": mesh, "environment": environment, "material": spec, "fixed": points})
    scenes.save(
        options.output, device=device.name, size=options.size, rows=rows, scenes=frontier,
        command=f"python bench/plan.py --size {options.size[0]}x{options.size[1]} --spp {options.spp}"
        + (" --no-fixed" if options.no_fixed else "") + (" --beside RESULT" if options.beside else ""),
    )  # fmt: skip


def one_scene(device: Device, mesh: str, environment: str, spec: str, options: argparse.Namespace):  # type: ignore[no-untyped-def]
    """A row for every error asked, and all fixed settings' errors and times."""
    shape, light = (
        read_mesh(scenes.mesh_path(mesh)),
        read_environment(scenes.environment_path(environment))[0],
    )
    camera = Camera.framing(shape.bounds, size=options.size)

    def made(**settings: float | str | None) -> Scene:
        return Scene(shape, light, spec, camera, device=device, **settings)

    truth = Truth(made(), options.spp)
    made().render(samples=1)  # kernels built, light split
    if options.beside is not None:
        earlier = json.loads(options.beside.read_text())["scenes"]
        known = next(own["fixed"] for own in earlier if (own["mesh"], own["environment"], own["material"]) ==
                     (mesh, environment, spec))  # fmt: skip
        best = {error: best_of(known, error) for error in options.errors}
        fixed = again(made, truth, [own for own in best.values() if own is not None])
    else:
        fixed = [] if options.no_fixed else list(frontier(made, truth, min(options.errors)))
        best = {error: best_of(fixed, error) for error in options.errors}
    rows = []
    for error in options.errors:
        scene = made()
        start = time.perf_counter()
        try:
            render = scene.render(error=error)
        except InputError as refused:
            rows.append({"asked": error, "refused": str(refused)})
            continue
        seconds = time.perf_counter() - start
        plan = render.plan
        assert plan is not None
        beside = best[error]
        if beside is not None:
            beside = next(own for own in fixed if settings_of(own) == settings_of(beside))
        rows.append(
            {
                "asked": error, "predicted": plan.predicted, "true": truth.error(render.image), "seconds": seconds,
                "pilot_seconds": plan.pilot_seconds, "expected_seconds": plan.seconds,
                "confidence": plan.confidence, "bias": plan.bias, "bias_uncertain": plan.bias_uncertain,
                "rays": plan.settings[0].rays, "levels": plan.settings[0].levels,
                "pixel_error": plan.settings[0].pixel_error, "hard_error": plan.settings[0].hard_error,
                "points_per_pixel": render.report["points_per_pixel"], "audits": render.report["plan"]["audits"],
                "best_fixed": beside,
            }
        )  # fmt: skip
    return rows, fixed


def best_of(fixed: list[dict], error: float) -> dict | None:  # type: ignore[type-arg]
    """The fastest that errs by no more than that."""
    good = [own for own in fixed if own["error"] <= error]
    return min(good, key=lambda own: own["seconds"]) if good else None


def settings_of(found: dict) -> dict:  # type: ignore[type-arg]
    """What was fixed."""
    return {key: value for key, value in found.items() if key not in ("seconds", "error")}


def again(made, truth: Truth, found: list[dict]):  # type: ignore[no-untyped-def, type-arg]
    """Some settings once more, each once."""
    out: list[dict] = []  # type: ignore[type-arg]
    for own in map(settings_of, found):
        if all(settings_of(other) != own for other in out):
            by_hand = {key: value for key, value in own.items() if key != "samples"}
            out.append(timed(made(**by_hand), truth, own, samples=own.get("samples")))
    return out


def frontier(made, truth: Truth, least: float):  # type: ignore[no-untyped-def]
    """Fixed settings from coarse to fine, until nothing finer can be the best for any error asked."""
    best = np.inf
    for rays in RAYS:
        for samples in SAMPLES:
            found = timed(made(rays=rays), truth, {"rays": rays, "samples": samples}, samples=samples)
            yield found
            best = min(best, found["seconds"] if found["error"] <= least else np.inf)
            if found["error"] <= least or found["seconds"] > best:
                break
        for aim in AIMS:
            found = timed(made(rays=rays, pixel_error=aim), truth, {"rays": rays, "pixel_error": aim})
            yield found
            best = min(best, found["seconds"] if found["error"] <= least else np.inf)
            if found["error"] <= least or found["seconds"] > best:
                break


def timed(scene: Scene, truth: Truth, told: dict, samples: int | None = None) -> dict:  # type: ignore[type-arg]
    start = time.perf_counter()
    render = scene.render(samples=samples)
    return {**told, "seconds": time.perf_counter() - start, "error": truth.error(render.image)}


def line(row: dict) -> str:  # type: ignore[type-arg]
    """One row in words."""
    name = f"{row['mesh']:15} {row['environment']:22} {row['material']:28} asked {100 * row['asked']:.1f} %"
    if "refused" in row:
        return f"{name}: refused"
    best = row["best_fixed"]
    beside = f", best fixed {best['seconds']:.2f} s: {row['seconds'] / best['seconds']:.2f} x" if best else ""
    return (
        f"{name}: predicted {100 * row['predicted']:.2f} true {100 * row['true']:.2f} % "
        f"({row['predicted'] / max(row['true'], 1e-9):.2f}), 4^{row['rays']} rays, {row['seconds']:.2f} s "
        f"(pilot {row['pilot_seconds']:.2f}){beside}"
    )


if __name__ == "__main__":
    main()
