"""What a change costs here and in Mitsuba 3 at equal error: a view and a material, or a light, on the same cores.

    DRJIT_LIBLLVM_PATH=/path/to/libLLVM-19.so python bench/change.py [-o bench/results/change.json]

`view+brdf`: a frame with a new eye and a new material, 40,000 vertices that face the eye (some of them twice where
there are fewer), for several settings of a session's `error`. Light and visibility are there. Medians of nine frames.

`light`: another light, or the same one turned, to radiance at 300,000 vertices, all collapsed and shaded anew. Each is
seen from that of four eyes around the mesh which it faces most. Visibility is there, rays to the hard light's samples
are counted, reading the file is not. Medians of three.

Mitsuba's `direct` integrator estimates the same vertices towards the same eyes; scene, rays and kernels are ready. Its
error is its noise alone, what two runs differ by over the square root of two. Where an image with as many pixels on the
mesh takes it less time for a sample of these (`mi.render`), it is timed by that. Its time at our error is read off its
curve on log scales. Beyond the last run at all vertices (`extrapolated`) time grows as the samples do, and noise is
that of 512 of them, for stratified samples gain more than independent ones; beyond these runs, too, it falls by half
for four times the samples.

Our error is relative RMSE against equation (1) on 256 x 256 directions in float64 at a sample of vertices. That shares
the session's rays and frames, so beside it stands the difference from Mitsuba at many samples there, its noise taken
off in quadrature (`check`), and how many times faster we are if that were our error (`times_faster_by_check`).
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import scenes
from editing import rmse, truth
from rival import Rival

from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import shoot
from prtcl.scene.scene import read_environment
from prtcl.scene.session import ERROR, Session

ERRORS = (0.0, 0.003, 0.01, 0.03, 0.1)
FRAMES, LIGHTS = 9, 3
LEVELS = 6
TURN = 90.0
"""Degrees that a light is turned by."""
EYES = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / np.sqrt(3)
"""Around a mesh: some eye is at most 71 degrees off any normal, were they far away."""
WELL = 0.15
"""Errors are taken at vertices that show at least this share of their area."""
SPP = tuple(4**n for n in range(9))
FEW = 512
"""Vertices that show how noise goes on where all take too long."""
CHECK_SPP = 4**8
"""Samples of a vertex in each half of the check."""


@dataclass(frozen=True)
class Places:
    """Vertices, each with the eye that it is seen from.

    Attributes
    ----------
    vertices : (n,), own : (n,) which of eyes (k, 3)
    shown : (n,) cosine of normal and view
    """

    vertices: np.ndarray  # type: ignore[type-arg]
    own: np.ndarray  # type: ignore[type-arg]
    eyes: np.ndarray  # type: ignore[type-arg]
    shown: np.ndarray  # type: ignore[type-arg]

    @classmethod
    def facing(cls, mesh: Mesh, eyes: np.ndarray) -> Places:  # type: ignore[type-arg]
        """All vertices that face one of the eyes, with that which they face most."""
        assert mesh.normals is not None
        towards = eyes[:, None] - mesh.vertices
        shown = (towards * mesh.normals).sum(axis=2) / np.linalg.norm(towards, axis=2)
        own, most = shown.argmax(axis=0), shown.max(axis=0)
        used = np.zeros(len(mesh.vertices), dtype=bool)
        used[mesh.faces] = True
        vertices = np.flatnonzero((most > 0) & used)
        return cls(vertices, own[vertices], eyes, most[vertices])

    def __getitem__(self, which: np.ndarray) -> Places:  # type: ignore[type-arg]
        return replace(self, vertices=self.vertices[which], own=self.own[which], shown=self.shown[which])

    def some(self, count: int, seed: int) -> Places:
        """At most so many, by chance, in their order."""
        order = np.random.default_rng(seed).permutation(len(self.vertices))
        return self[np.sort(order[:count])]

    @property
    def each_eye(self) -> np.ndarray:  # type: ignore[type-arg]
        return self.eyes[self.own]

    def radiance(self, session: Session) -> tuple[np.ndarray, dict[str, float]]:  # type: ignore[type-arg]
        """(n, 3), one eye after another, and the session's seconds by stage."""
        out, seconds = np.zeros((len(self.vertices), 3), dtype=np.float32), {}
        for k, eye in enumerate(self.eyes):
            which = np.flatnonzero(self.own == k)
            if len(which):
                out[which] = session.radiance(tuple(eye), self.vertices[which])
                for stage, spent in session.last.seconds.items():
                    seconds[stage] = seconds.get(stage, 0.0) + spent
        return out, seconds


def with_alpha(radiance: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """As `scenes.relative_rmse` wants its pixels."""
    return np.concatenate([radiance, np.ones((len(radiance), 1), dtype=radiance.dtype)], axis=1)


def unturned(light: Environment) -> Environment:
    """The same light with its rotation in the map's columns, where that is a whole number of them."""
    columns = light.image.shape[1] * light.rotate / 360.0
    assert columns == round(columns)
    return replace(light, image=np.roll(light.image, -round(columns), axis=1), rotate=0.0)


# --- Mitsuba ------------------------------------------------------------------------------------------------


def camera_for(session: Session, pixels: int) -> Camera:
    """The session's view with about so many pixels on the mesh."""
    trial = replace(session.camera, size=(128, 128))
    every = np.arange(128 * 128)
    share = len(shoot(session.tracer, trial, every, np.zeros_like(every)).ray) / len(every)
    side = round(np.sqrt(pixels / share))
    return replace(session.camera, size=(side, side))


def near_together(positions: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """An order in which neighbours follow each other: Morton's, on 256 cells a side. Mitsuba's rays are faster so."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    cells = ((positions - low) / max((high - low).max(), 1e-300) * 255).astype(np.int64)
    keys = sum(((cells[:, axis] >> bit) & 1) << (3 * bit + axis) for bit in range(8) for axis in range(3))
    return np.argsort(keys, kind="stable")


def seconds_of(job: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    start = time.perf_counter()
    result = job(*arguments)
    return time.perf_counter() - start, result


@dataclass
class Curve:
    """Mitsuba's time and noise.

    Attributes
    ----------
    way : "points" or "image", whichever took less time a sample
    rates : million samples a second on the mesh, by way
    rows : spp, seconds, noise; beyond : the same, of few vertices, the seconds those of all
    check : (n, 3) at the sampled places, half by half
    """

    way: str
    rates: dict[str, float]
    rows: list[tuple[int, float, float]]
    beyond: list[tuple[int, float, float]]
    check: list[np.ndarray]  # type: ignore[type-arg]

    def at(self, error: float) -> tuple[float, bool]:
        """Seconds to a noise of `error`, and whether that lies beyond the last run; at least those of one sample."""
        _, seconds, noise = np.array(self.rows + self.beyond).T
        noise = np.minimum.accumulate(noise)  # fireflies
        extrapolated = bool(error < noise[len(self.rows) - 1])
        if error < noise[-1]:
            return float(seconds[-1] * (noise[-1] / error) ** 2), extrapolated
        found = np.interp(np.log(error), np.log(noise[::-1]), np.log(seconds[::-1]))
        return float(np.exp(found)), extrapolated


def noise_of(one: np.ndarray, other: np.ndarray) -> float:  # type: ignore[type-arg]
    """Of either of two independent estimates (n, 4)."""
    return float(scenes.relative_rmse(one, other) / np.sqrt(2))


def mitsuba_curve(session: Session, spec: str, places: Places, sample: Places, options: Any) -> Curve:
    """Time and noise at the places, spp after spp until a run takes longer than the limit; the check at `sample`."""
    session.material = spec
    places = places[near_together(session.mesh.vertices[places.vertices])]
    rival = Rival(session.mesh, session.light, session.material, camera_for(session, len(places.vertices)))
    rays, well = rival.rays(places.vertices, places.each_eye), places.shown > WELL
    # Of two runs each the first may have compiled kernels: the faster one counts.
    trial_spp = 16
    points = min(seconds_of(rival.radiance, rays, trial_spp, seed)[0] for seed in (1, 2, 3))
    images = [seconds_of(rival.render, trial_spp, seed) for seed in (1, 2, 3)]
    image, on_mesh = min(seconds for seconds, _ in images), float(images[0][1][..., 3].sum())
    rates = {
        "points": len(places.vertices) * trial_spp / points * 1e-6,
        "image": on_mesh * trial_spp / image * 1e-6,
    }
    way, rows, beyond = max(rates, key=rates.__getitem__), [], []
    few = np.sort(np.random.default_rng(9).permutation(np.flatnonzero(places.shown > WELL))[:FEW])
    few_rays = rival.rays(places.vertices[few], places.each_eye[few])
    spent = 0.0
    for spp in SPP:
        if 4 * spent > options.limit:  # about what this run would take
            break
        runs = [seconds_of(rival.radiance, rays, spp, seed) for seed in (1, 2)]
        spent = best = min(seconds for seconds, _ in runs)
        if way == "image":
            best = min(seconds_of(rival.render, spp, seed)[0] for seed in (1, 2))
        rows.append((spp, best, noise_of(*(estimate[well] for _, estimate in runs))))
        noise_of_few = noise_of(*(estimate[few] for _, estimate in runs))
    last_spp, last, noise = rows[-1]
    spent = spent * len(few) / len(places.vertices)
    for spp in SPP[len(rows) :]:
        if spent * spp / last_spp > options.limit:
            break
        more = noise_of(*(rival.radiance(few_rays, spp, seed) for seed in (1, 2)))
        beyond.append((spp, last * spp / last_spp, noise * more / noise_of_few))
    rays = rival.rays(sample.vertices, sample.each_eye)
    check = [rival.radiance(rays, options.check_spp, seed)[:, :3] for seed in (3, 4)]
    return Curve(way, rates, rows, beyond, check)


def compared(
    what: dict[str, Any],
    seconds: float,
    got: np.ndarray,
    exact: np.ndarray,
    curve: Curve,  # type: ignore[type-arg]
) -> dict[str, Any]:
    """A row: ours beside Mitsuba's."""
    even = np.ones(len(exact))
    error = rmse(got, exact, even)
    converged = (curve.check[0].astype(np.float64) + curve.check[1]) / 2
    noise = noise_of(*(with_alpha(half) for half in curve.check)) / np.sqrt(2)
    differs, exact_differs = (
        np.sqrt(max(0.0, rmse(x, converged, even) ** 2 - noise**2)) for x in (got, exact)
    )
    theirs, extrapolated = curve.at(error)
    row = {
        **what, "seconds": seconds, "error": error,
        "check": {
            "rmse": float(differs), "noise": noise, "bias": float(got.mean() / converged.mean() - 1),
            "exact_rmse": float(exact_differs), "exact_bias": float(exact.mean() / converged.mean() - 1),
        },
        "mitsuba": curve.rows, "mitsuba_beyond": curve.beyond, "mitsuba_way": curve.way,
        "mitsuba_million_samples_per_second": curve.rates,
        "mitsuba_seconds_at_our_error": theirs, "extrapolated": extrapolated, "times_faster": theirs / seconds,
        "times_faster_by_check": curve.at(max(error, float(differs)))[0] / seconds,
    }  # fmt: skip
    check = row["check"]
    print(
        f"{row['kind']:9} {row['environment']:18} {row['change']:17} {row['material']:28} {row['points']} points, "
        f"setting {row['setting']:g}: {1e3 * seconds:.1f} ms, error {100 * error:.2f} % (against Mitsuba "
        f"{100 * check['rmse']:.2f} %, noise {100 * check['noise']:.2f} %, bias {100 * check['bias']:+.2f} %, the "
        f"integral's {100 * check['exact_rmse']:.2f} %, {100 * check['exact_bias']:+.2f} %); "
        f"Mitsuba {theirs:.3g} s by {curve.way}{', extrapolated' if extrapolated else ''}: "
        f"{row['times_faster']:.3g} times faster, {row['times_faster_by_check']:.3g} by the check",
        flush=True,
    )
    return row


# --- the two changes ----------------------------------------------------------------------------------------


def another(spec: str, frame: int) -> str:
    """The material with its last number a little higher: an edit."""
    text, _, number = spec.rpartition("=")
    return f"{text}={float(number) + 1e-3 * frame:g}"


def views(device: Device, environment: str, options: Any) -> list[dict[str, Any]]:
    """Frames of a new view and a new material."""
    session = Session(
        scenes.mesh_path(options.mesh), scenes.environment_path(environment), device=device, levels=LEVELS
    )
    facing = Places.facing(session.mesh, np.array([session.camera.eye]))
    places = facing.some(options.points, 5)
    places = places[np.resize(np.arange(len(places.vertices)), options.points)]
    sample = facing[facing.shown > WELL].some(options.sample, 6)
    places.radiance(session)  # traces and collapses
    exact = truth(session, sample.vertices, sample.each_eye, options.materials)
    rows = []
    for m, spec in enumerate(options.materials):
        curve = mitsuba_curve(session, spec, places, sample, options)
        for setting in options.errors:
            session.error, session.material = setting, spec
            first, _ = seconds_of(places.radiance, session)
            got, _ = sample.radiance(session)
            seconds = []
            device.profile.reset()
            for frame in range(FRAMES + 1):
                moved = replace(places, eyes=places.eyes + 1e-3 * frame * session.mesh.scale)
                start = time.perf_counter()
                session.material = another(spec, frame)
                moved.radiance(session)
                seconds.append(time.perf_counter() - start)
            stages = {k: v / (FRAMES + 1) for k, v in device.profile.device_seconds().items()}
            what = {
                "kind": "view+brdf", "mesh": options.mesh, "environment": environment, "change": "view and material",
                "material": spec, "points": len(places.vertices), "vertices": len(np.unique(places.vertices)),
                "setting": setting, "first_with_a_new_cut_seconds": first, "device_seconds": stages,
            }  # fmt: skip
            rows.append(compared(what, median(seconds[1:]), got, exact[m], curve))
    return rows


def lights(device: Device, options: Any) -> list[dict[str, Any]]:
    """A new light, and the same turned."""
    maps = [read_environment(scenes.environment_path(name))[0] for name in options.environments]
    session = Session(scenes.mesh_path(options.light_mesh), maps[-1], device=device, levels=LEVELS)
    target = np.asarray(session.camera.target)
    away = np.linalg.norm(np.asarray(session.camera.eye) - target)
    facing = Places.facing(session.mesh, target + away * EYES)
    places = facing.some(options.light_points, 7)
    well = np.flatnonzero(places.shown > WELL)
    chosen = np.sort(np.random.default_rng(8).permutation(well)[: options.sample])
    sample = places[chosen]
    _, once = places.radiance(session)
    print(f"{len(places.vertices)} of {len(session.mesh.vertices)} vertices; once: {once}", flush=True)
    rows = []
    for name, light in zip(options.environments, maps, strict=True):
        changes: tuple[tuple[str, Callable[[int], None]], ...] = (
            # An `Environment` keeps how it was split: a light that is new has nothing to keep yet.
            ("another light", lambda run, light=light: setattr(session, "light", Environment(light.image))),
            ("the same, turned", lambda run: session.rotate_light(TURN + run)),
        )
        for change, make in changes:
            exact = None
            for m, spec in enumerate(options.materials):
                session.material, session.error = spec, ERROR
                seconds, stages, device_stages = [], [], []
                for run in reversed(range(LIGHTS)):  # the last one is what the others are compared at
                    device.profile.reset()
                    start = time.perf_counter()
                    make(run)
                    got, spent = places.radiance(session)
                    seconds.append(time.perf_counter() - start)
                    stages.append(spent)
                    device_stages.append(device.profile.device_seconds())
                if exact is None:
                    exact = truth(
                        session, sample.vertices, sample.each_eye, options.materials, unturned(session.light)
                    )
                curve = mitsuba_curve(session, spec, places, sample, options)
                middle = int(np.argsort(seconds)[LIGHTS // 2])
                what = {
                    "kind": "light", "mesh": options.light_mesh, "environment": name, "change": change,
                    "material": spec, "points": len(places.vertices), "vertices": len(places.vertices),
                    "setting": ERROR, "stage_seconds": stages[middle], "device_seconds": device_stages[middle],
                }  # fmt: skip
                rows.append(compared(what, seconds[middle], got[chosen], exact[m], curve))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--mesh", default="stanford_bunny")
    parser.add_argument("--light-mesh", default="bob_342k")
    parser.add_argument("--environments", nargs="+", default=scenes.ENVIRONMENTS[:2])
    parser.add_argument("--materials", nargs="+", default=scenes.MATERIALS)
    parser.add_argument("--kinds", nargs="+", choices=("view+brdf", "light"), default=("view+brdf", "light"))
    parser.add_argument("--errors", nargs="+", type=float, default=ERRORS, help="a session's, for view+brdf")
    parser.add_argument("--points", type=int, default=40_000)
    parser.add_argument("--light-points", type=int, default=300_000)
    parser.add_argument("--sample", type=int, default=100, help="vertices that errors are taken at")
    parser.add_argument("--limit", type=float, default=20.0, help="seconds that a run of Mitsuba may take")
    parser.add_argument("--check-spp", type=int, default=CHECK_SPP)
    options = parser.parse_args()
    scenes.require_data()
    device, rows = Device(), []
    if "view+brdf" in options.kinds:
        for environment in options.environments:
            rows += views(device, environment, options)
    if "light" in options.kinds:
        rows += lights(device, options)
    given = {name: value for name, value in vars(options).items() if value != parser.get_default(name)}
    given.pop("output", None)
    scenes.save(
        options.output, device=device.name, driver=device.driver, command="python bench/change.py",
        mitsuba=importlib.metadata.version("mitsuba"), date=datetime.date.today().isoformat(), options=given,
        sample=options.sample, limit=options.limit, rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
