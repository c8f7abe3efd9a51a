"""Whether images flicker while their light turns: the error of both factorizations, frame by frame.

    python bench/flicker.py [-o bench/results/flicker.json] [--lights sky sun] [--pixels 32] [--frames 8]

Each row is one light, turned in steps of 1 and of 0.25 degrees, one material and one factorization, on pixels of
the demo's scene: half of them are such that the light's brightest place comes or goes there while it turns, `edge`, the
others are taken at random, `elsewhere`. What is measured is the error e_t of frame t against a float64 reference, over
the mean radiance of the pixels in all frames:

    error    RMS of e_t
    flicker  RMS of e_(t+1) − e_t
    jolt     RMS of e_(t+1) − 2 e_t + e_(t−1), which an error that moves steadily has none of
    moved    RMS of what the reference itself changes from frame to frame
    noise    the jolt of the reference's own error, half the difference of its two halves

An error that is smooth in the angle has a sixteenth of the jolt at a quarter of the step. Steps that come at random
moments, such as a shadow's edge that passes a sub-pixel point, have half.

The reference does not turn with the light, so that none of its own errors jumps: transport is fixed, T(ω) of each pixel
in cells of 4**8 a hemisphere, from RAYS rays of different sub-pixel points a cell, and the map below a threshold is
averaged over each cell at 4 × 4 places. Above the threshold (a sun, lamps) each texel is PEAK_SIDE² directions a frame,
each from 2 MET of the sub-pixel points.

`rigid` is the farthest that any sample of hard light lies from where the first frame's turns to, of all angles that are
whole degrees: 0 to rounding where clusters and groups are those of the map's own axes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import scenes

from prtcl import quadtree, reference
from prtcl.apps.demo_scene import build
from prtcl.compute.device import Device
from prtcl.factors import hard_groups, hemisphere, pixel_visibility, sphere
from prtcl.factors.environment import Environment
from prtcl.factors.hard_groups import HardGroups
from prtcl.factors.material import Material
from prtcl.factors.sky import sun_sky
from prtcl.factors.visibility import Tracer, in_parallel
from prtcl.scene.camera import Camera
from prtcl.scene.factorization import engine_of
from prtcl.scene.frames_looks import Looks
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import read_environment
from prtcl.transport.light_columns import SHARE, SPREAD

LEVELS, PLACES, RAYS, PEAK_SIDE, MET = 8, 4, 4, 4, 8
THRESHOLD = 20.0
"""Of the mean radiance: what lies above it the reference sums texel by texel."""
STEPS = (1.0, 0.25)
START = 20.0
LONGEST = 1 << 17
WAYS = (
    ("light", {}), ("light", {"samples": 8}),
    ("view", {}), ("view", {"uneven": -1.0}), ("view", {"uneven": -1.0, "pairs": 512}),
)  # fmt: skip
"""Factorizations as they are, and with one number changed, to tell what the error comes from: points along a pixel's
side; all samples of hard light traced, whatever their probes say (no pixel is even); and four times as many of them."""


class Pixels:
    """Sub-pixel points of some pixels and their float64 transport."""

    def __init__(self, mesh, tracer, camera, pixels, materials, points) -> None:  # type: ignore[no-untyped-def]
        self.tracer, self.materials, self.each = tracer, materials, points
        sub = np.tile(np.arange(points), len(pixels))
        hits = shoot(tracer, camera, np.repeat(pixels, points), sub)
        if len(hits.ray) != len(sub):
            raise SystemExit("a pixel is not covered by all of its points")
        self.points = pixel_points(mesh, tracer, hits, np.zeros_like(sub))
        self.count = len(pixels)
        rng = np.random.default_rng(3)
        cells = sphere.n_cells(LEVELS)
        world = sphere.centres(LEVELS)[:, :3].astype(np.float64)
        self.soft = np.zeros((2, self.count, len(materials), cells))
        for pixel in range(self.count):
            for ray in range(RAYS):
                point = pixel * points + rng.permutation(np.arange(cells) % points)
                self.soft[ray % 2, pixel] += self.reflected(point, world).T * (2 / RAYS)
        self.soft *= 2 * np.pi / quadtree.n_samples(LEVELS)

    def reflected(self, point, world):  # type: ignore[no-untyped-def]
        """V f cos of pairs of a point and a direction, in every (grey) material: (n, materials)."""
        out = np.zeros((len(point), len(self.materials)))

        def run(part: slice) -> None:
            own, towards = point[part], world[part]
            frames = self.points.frames[own].astype(np.float64)
            local = np.einsum("nij,nj->ni", frames, towards)
            up = np.flatnonzero(local[:, 2] > 0)
            seen = ~self.tracer.occluded(self.points.origins[own[up]], towards[up].astype(np.float32))
            up = up[seen]
            views = self.points.views[own[up]].astype(np.float64)
            for number, material in enumerate(self.materials):
                f = reference.brdf(material, local[up], views)[:, 0]
                out[part.start + up, number] = f * local[up, 2]

        in_parallel(run, len(point), 1 << 15)
        return out

    def frame(self, light, environment):  # type: ignore[no-untyped-def]
        """Radiance of both halves: (2, pixels, materials, 3)."""
        total = np.einsum("hpmc,cx->hpmx", self.soft, light.below(environment), optimize=True)
        world = light.peaks @ environment.to_map
        if not len(world):
            return total
        for half in (0, 1):
            for pixel in range(self.count):
                # Each sample meets some points that follow one another, and so are spread over the pixel.
                pairs = np.add.outer(np.arange(MET), MET * np.arange(len(world))) % (self.each // 2)
                point = pixel * self.each + half * (self.each // 2) + pairs
                which = np.broadcast_to(np.arange(len(world)), pairs.shape)
                weight = self.reflected(point.ravel(), world[which.ravel()]).reshape(*pairs.shape, -1)
                total[half, pixel] += weight.mean(axis=0).T @ light.energy
        return total


class Light:
    """A map below and above the reference's threshold."""

    def __init__(self, environment) -> None:  # type: ignore[no-untyped-def]
        solid = environment.texel_solid_angles()[:, None]
        self.image = environment.image.astype(np.float64)
        mean = float((self.image.mean(axis=2) * solid).sum() / (4 * np.pi))
        self.threshold = THRESHOLD * mean
        self.peaks, self.energy = reference.peaks(self.image, self.threshold, PEAK_SIDE)
        side = PLACES << LEVELS
        v, u = np.divmod(np.arange(side * side), side)
        local = hemisphere.from_square((u + 0.5) / side, (v + 0.5) / side)
        order = quadtree.grid_to_morton(LEVELS)[v // PLACES, u // PLACES]
        self._world = local[np.argsort(order, kind="stable")]

    def below(self, environment):  # type: ignore[no-untyped-def]
        """Soft radiance averaged over the reference's cells: (cells, 3)."""
        means = np.empty((2, quadtree.n_samples(LEVELS), 3))
        for half, axes in enumerate(sphere.FRAMES.astype(np.float64)):
            turn = axes @ environment.to_map.T

            def run(part: slice, half: int = half, turn: np.ndarray = turn) -> None:
                got = reference.environment_below(self.image, self._world[part] @ turn, self.threshold)
                cells = slice(part.start // PLACES**2, part.stop // PLACES**2)
                means[half, cells] = got.reshape(-1, PLACES**2, 3).mean(axis=1)

            in_parallel(run, len(self._world), LONGEST)
        return means.reshape(-1, 3)


def chosen(mesh, tracer, camera, covered, light, turned, count):  # type: ignore[no-untyped-def]
    """Pixels, ascending, half of which the brightest place of a turning light enters or leaves, and which those are."""
    rng = np.random.default_rng(7)
    some = rng.choice(covered, min(len(covered), 8000), replace=False)
    hits = shoot(tracer, camera, some, np.zeros_like(some))
    points = pixel_points(mesh, tracer, hits, np.zeros_like(hits.ray))
    brightest = (
        light.peaks[np.argmax(light.energy.sum(axis=1))] if len(light.peaks) else np.array([0.0, 1.0, 0.0])
    )
    lit = []
    for environment in turned:
        towards = np.broadcast_to((brightest @ environment.to_map).astype(np.float32), points.origins.shape)
        above = np.einsum("nx,nx->n", points.frames[:, 2], towards) > 0
        lit.append(above & ~tracer.occluded(points.origins, np.ascontiguousarray(towards)))
    changes = np.ptp(np.array(lit, dtype=np.int8), axis=0) > 0
    edge, rest = some[hits.ray[changes]][: count // 2], some[hits.ray[~changes]]
    pixels = np.sort(np.concatenate([edge, rest[: count - len(edge)]]))
    return pixels, np.isin(pixels, edge)


def rigid(environment) -> float:  # type: ignore[no-untyped-def]
    """How far hard samples lie from where the first frame's would turn to."""
    first, farthest = None, 0.0
    for degrees in range(360):
        turned = replace(environment, rotate=float(degrees))
        groups = HardGroups.of(turned.split(sphere.FINEST, "auto", share=SHARE, spread=SPREAD))
        own = groups.samples[:, :3] @ turned.to_map.T
        first = own if first is None else first
        farthest = max(farthest, float(np.abs(own - first).max(initial=0.0)))
    return farthest


def frames(factorization, changed, mesh, tracer, camera, pixels, specs, turns, device):  # type: ignore[no-untyped-def]
    """What an engine makes of some pixels: (frames, materials, pixels, 3) float64."""
    defaults = hard_groups.PAIRS, pixel_visibility.UNEVEN
    hard_groups.PAIRS = changed.get("pairs", defaults[0])
    pixel_visibility.UNEVEN = changed.get("uneven", defaults[1])
    engine = engine_of(
        factorization, mesh, Looks(specs, mesh), device, points="pixel", samples=changed.get("samples"),
        two_sided=True, bits=None, hard=changed.get("hard", "auto"), tracer=tracer,
    )  # fmt: skip
    engine.prepare(camera, pixels)
    made = [image[0, :, :3] for image in engine.images((turn, range(len(specs))) for turn in turns)]
    hard_groups.PAIRS, pixel_visibility.UNEVEN = defaults
    return np.stack(made).reshape(len(turns), len(specs), len(pixels), 3).astype(np.float64)


def rms(values, mean):  # type: ignore[no-untyped-def]
    return float(np.sqrt((values**2).mean()) / mean)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--pixels", type=int, default=32)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--points", type=int, default=256)
    parser.add_argument("--lights", nargs="+", default=["sky", "sun", "modern_buildings_2"])
    parser.add_argument("--as-is", action="store_true", help="only factorizations with nothing changed")
    options = parser.parse_args()
    device = Device()
    mesh = build()
    camera = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(240, 180))
    tracer = Tracer(mesh.vertices, mesh.faces)
    every = np.arange(camera.size[0] * camera.size[1])
    hits = shoot(tracer, camera, np.repeat(every, 64), np.tile(np.arange(64), len(every)))
    covered = np.flatnonzero(np.bincount(hits.ray // 64, minlength=len(every)) == 64)
    specs = list(scenes.MATERIALS)
    own = [Material.parse(spec).reference() for spec in specs]
    rows = []
    for name in options.lights:
        if name in ("sky", "sun"):
            image = sun_sky(512, sun_elevation=40.0, sun_azimuth=130.0)
            image = np.minimum(image, 4 * np.median(image)) if name == "sky" else image
            environment = Environment(image.astype(np.float32), name=f"generated {name}")
        else:
            scenes.require_data()
            environment = read_environment(scenes.environment_path(name))[0]
        light = Light(environment)
        turned = [replace(environment, rotate=START + i) for i in range(options.frames)]
        pixels, edge = chosen(mesh, tracer, camera, covered, light, turned, options.pixels)
        truth = Pixels(mesh, tracer, camera, pixels, own, options.points)
        moved_by = rigid(environment)
        print(f"{name}: {len(light.peaks)} peaks, rigid to {moved_by:.2g}", flush=True)
        for step in STEPS:
            turns = [replace(environment, rotate=START + step * i) for i in range(options.frames)]
            halves = np.stack([truth.frame(light, turned) for turned in turns])
            exact, noise = halves.mean(axis=1), (halves[:, 0] - halves[:, 1]) / 2
            for factorization, changed in WAYS:
                if changed and options.as_is:
                    continue
                got = frames(factorization, changed, mesh, tracer, camera, pixels, specs, turns, device)
                for (number, spec), where in product(enumerate(specs), ("edge", "elsewhere")):
                    some = np.flatnonzero(edge == (where == "edge"))
                    if not len(some):  # no peak, no edge
                        continue
                    want, random = exact[:, some, number], noise[:, some, number]
                    error, mean = got[:, number, some] - want, float(want.mean())
                    row = {
                        "light": name, "step": step, "factorization": factorization, "changed": changed,
                        "where": where, "material": spec, "error": rms(error, mean),
                        "flicker": rms(np.diff(error, axis=0), mean),
                        "jolt": rms(np.diff(error, 2, axis=0), mean), "moved": rms(np.diff(want, axis=0), mean),
                        "noise": rms(np.diff(random, 2, axis=0), mean), "rigid": moved_by,
                    }  # fmt: skip
                    rows.append(row)
                    told = "  ".join(
                        f"{k} {row[k]:.2e}" for k in ("error", "flicker", "jolt", "moved", "noise")
                    )
                    print(
                        f"{name:12.12} {step:4} {factorization:5} {changed!s:15} {where:9} {spec:14.14} {told}",
                        flush=True,
                    )
    command = "python bench/flicker.py " + "--as-is " * options.as_is + "--lights " + " ".join(options.lights)
    scenes.save(
        options.output, command=command, device=device.name, pixels=options.pixels, frames=options.frames,
        points=options.points, start=START, rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
