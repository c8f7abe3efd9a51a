"""Radiance through the whole pipeline and through a session, from the dimmest to the brightest that float32 holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import bounds
from prtcl.apps.bench import world
from prtcl.apps.bench.oracle import gathered, slice_samples
from prtcl.apps.stress import oracle
from prtcl.apps.stress.oracle import Array
from prtcl.apps.stress.products import product_bound
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute.device import Device
from prtcl.factors import hemisphere
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials, ViewTable, subsamples
from prtcl.factors.visibility import Tracer
from prtcl.scene.bake import Bake
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import vertex_points
from prtcl.scene.session import Session
from prtcl.transport import collapse, shade
from prtcl.transport.pipeline import Pipeline, Points
from prtcl.transport.settings import Settings

SPEC = "ggx:alpha=0.3,eta=0.2/0.4/1.3,k=3.4/2.3/1.8"
ALPHA = 0.3
COUNT, LEVELS, NODES = 24, 4, 32
POWERS = (-133, -126, -100, -66, -33, 0, 33, 66, 100, 120, 127)
"""The brightest radiance is 2 to these: 10⁻⁴⁰ … 10³⁸. Powers of two are exact, so one answer serves all of them."""
DIMMEST_SUN = -100
"""The same under a sun: below it float32 has no numbers for the sky."""
U32 = 2.0**-24
"""Directions are tables of float32 in every precision, and with them what they reach."""
SUN = 1e9
EYE = (0.4, 1.1, 2.9)
SAME_UNIT = (
    "radiance is stored in a power of two of its own (prtcl.transport.pipeline), so that sums neither overflow nor "
    "underflow; `before` is the same without it"
)


@cache
def sky(sun: float) -> Environment:
    """A smooth coloured sky; with `sun` one texel is that many times its mean. The brightest channel is 1.

    Values have ten bits, so that subnormal numbers hold them as well.
    """
    height = 16
    v, u = np.meshgrid(
        (np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / height, indexing="ij"
    )
    image = np.stack(
        [1 + 0.5 * np.sin(np.pi * u) * np.sin(np.pi * v), 1.2 + 0 * u, 1 + 0.6 * np.cos(np.pi * v)], -1
    )
    if sun:
        image[3, 5] = sun * image.mean()
    mantissa, exponent = np.frexp(image / image.max())
    return Environment(np.ldexp(np.round(mantissa * 1024) / 1024, exponent).astype(np.float32), name="sky")


def scaled(environment: Environment, power: int) -> Environment:
    """The same light times 2**power, exactly."""
    image = np.ldexp(environment.image.astype(np.float64), power).astype(np.float32)
    return Environment(image, name=environment.name)


def gather_bound(light: Light, frames: npt.ArrayLike, levels: int) -> Array:
    """|error| of soft radiance along every direction: (n, 3, 4**levels).

    A direction turned by a frame in float32 is off by 4 u, its place on a cube's face by 16 u of the face, with the
    division; radiance changes by so many texels times the range of the texels about, and is rounded six times.
    """
    cube = light.cube.astype(np.float64)
    face = cube.shape[1] - 2
    near = [np.roll(cube, (i, j), (1, 2)) for i in (-2, -1, 0, 1, 2) for j in (-2, -1, 0, 1, 2)]
    ranges = np.max(near, axis=0) - np.min(near, axis=0)
    slopes = replace(light, cube=ranges.astype(np.float32))
    return np.asarray(
        2 * 16 * U32 * face * gathered(slopes, frames, levels) + 8 * U32 * gathered(light, frames, levels)
    )


def expected(
    light: Light, points: Points, bits: npt.NDArray[np.uint32], hard_bits: npt.NDArray[np.uint32], m: Material,
    tree: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Radiance (n, 3) in float64, and its bound: the same cube, visibility and stored views as the pipeline has."""
    table = ViewTable.make(True, NODES)
    index, weight = table.locate(points.views)
    used, place = np.unique(index, return_inverse=True)
    f = slice_samples(m, table.views[used], LEVELS, subsamples(m, LEVELS))[place.reshape(index.shape)]
    f = np.einsum("nk,nkcs->ncs", weight.astype(np.float64), f)
    seen = world.unpacked(bits, LEVELS)[:, None]
    soft = gathered(light, points.frames, LEVELS)
    passed = soft * seen
    solid = 2 * np.pi / 4.0**LEVELS
    radiance = solid * (passed * f).sum(axis=-1)
    terms = 4**LEVELS // 4 + 12  # of the inner product's longest run (`bounds.inner_product`)
    k = 4 * LEVELS + 96 + 16 / ALPHA + terms
    bound = solid * (
        (gather_bound(light, points.frames, LEVELS) * seen * f).sum(axis=-1)
        + k * U32 * (bounds.norms(passed) * bounds.norms(f))[..., 0]
    )
    if tree:
        both = np.broadcast_to(seen, soft.shape).reshape(-1, 4**LEVELS) > 0
        error = product_bound("tree", soft.reshape(both.shape), both, LEVELS, "float32")
        bound = bound + solid * (error.reshape(*soft.shape[:2], 1) * bounds.norms(f))[..., 0]
    if len(light.hard):
        local = np.einsum("nij,lj->nli", points.frames.astype(np.float64), light.hard[:, :3])
        own = oracle.brdf(m, local, points.views.astype(np.float64)[:, None])
        on = np.unpackbits(hard_bits.astype("<u4").view(np.uint8), axis=1, bitorder="little")[
            :, : len(light.hard)
        ]
        cosine = np.maximum(local[..., 2:], 0.0)
        each = own * on[..., None] * light.hard[None, :, 3:]
        radiance = radiance + (each * cosine).sum(axis=1)
        k = 96 + 64 / ALPHA + len(light.hard)
        bound = bound + U32 * (each * (k * cosine + 8.0)).sum(axis=1)
    return radiance, bound


class Scene:
    """Points of the bench's ball under a sky, with their visibility."""

    def __init__(self, sun: float, hard: str = "auto", method: str = "auto") -> None:
        self.settings = Settings(LEVELS, LEVELS, LEVELS, views=NODES, hard=hard, method=method)
        self.sky, self.material = sky(sun), Material.parse(SPEC)
        self.points, self.tracer = world.points(COUNT), world.tracer()
        p = self.points
        self.bits = self.tracer.visibility(p.origins, p.frames, LEVELS, p.grid)
        light = self.sky.split(LEVELS, hard)
        self.hard = self.tracer.light_visibility(p.origins, p.frames[:, 2], light.hard[:, :3])
        self.expected, self.bound = expected(light, p, self.bits, self.hard, self.material, method == "tree")

    def rendered(self, device: Device, power: int) -> Array:
        """Through `Pipeline`."""
        pipeline = Pipeline(device, scaled(self.sky, power), [self.material], self.settings)
        return np.asarray(pipeline.radiance(self.tracer, self.points, self.bits))

    def without_unit(self, device: Device, power: int) -> Array:
        """The pipeline's own stages on the light as it is."""
        p, light = self.points, scaled(self.sky, power).split(LEVELS, self.settings.hard)
        materials, table = Materials(device, [self.material]), ViewTable.make(True, NODES)
        reduced = collapse.reduced_coefficients(device, light, self.bits, p.frames, self.settings)
        slices = materials.slices(table.views, LEVELS)[0]
        out = shade.soft_radiance(device, reduced, slices, *table.locate(p.views), LEVELS)
        shade.add_hard_radiance(device, materials, light, self.hard, p.material, p.frames, p.views, out)
        return np.asarray(out.get()[:, :3])


def _trial(device: Device, what: str, scene: Scene, power: int, **more: Any) -> Trial:
    # An answer below float32's normal range is rounded to a multiple of 2⁻¹⁴⁹.
    factor, last = 2.0**power, 2.0**-149
    return Trial(
        what,
        lambda: scene.rendered(device, power),
        scene.expected * factor,
        scene.bound * factor + last,
        "u (4 R + 160 + terms) ‖L V‖ ‖f‖ + the look-up's; u = 2⁻²⁴ in every precision, which is that of directions",
        scene.expected.max(axis=1, keepdims=True) * factor,
        "the point's radiance",
        at=f"brightest {2.0**power:.0e}",
        **more,
    )


@case("radiance", "Radiance from 1e-40 to 1e38 through the whole pipeline")
def radiance(device: Device, size: Size) -> Iterator[Trial]:
    """One scene under the same light in different units; and with a sun of 1e9 times the sky."""
    for what, sun in (("a sky", 0.0), (f"a sky, its sun {SUN:.0e} times as bright", SUN)):
        scene = Scene(sun)
        for power in POWERS[POWERS.index(DIMMEST_SUN) if sun else 0 :]:
            yield _trial(
                device, what, scene, power, note=SAME_UNIT,
                before=lambda scene=scene, power=power: scene.without_unit(device, power),
            )  # fmt: skip
    left_in = Scene(SUN, hard="off")
    yield _trial(device, f"a sun of {SUN:.0e} left in the map", left_in, 0)
    tree, tree_left_in = Scene(SUN, method="tree"), Scene(SUN, hard="off", method="tree")
    yield _trial(
        device, f"a sun of {SUN:.0e}, the product through the tree", tree, 0,
        before=lambda: tree_left_in.rendered(device, 0),
        note="hard light is taken out of the map and shaded by itself; `before` has it left in the map "
        "(--hard-light off), where the tree loses the sky of all points whose sun is hidden",
    )  # fmt: skip


@cache
def _vertices() -> Bake:
    """A bumpy ball of some hundred vertices, traced."""
    rows, columns = 9, 18
    theta = np.pi * (np.arange(rows) + 0.5) / rows
    t, p = np.meshgrid(theta, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    radius = 1 + 0.3 * np.sin(4 * p) * np.sin(3 * t)
    at = radius[..., None] * np.stack([np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)], axis=-1)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = (i * columns + j).ravel(), (i * columns + (j + 1) % columns).ravel()
    faces = np.concatenate([np.stack([a, b, a + columns], 1), np.stack([b, b + columns, a + columns], 1)])
    return Bake.trace(Mesh.from_arrays(at.reshape(-1, 3), faces), LEVELS)


def _session(device: Device, environment: Environment) -> Array:
    """Radiance of all vertices, every sample a leaf of the cut."""
    session = Session(_vertices(), environment, SPEC, device=device, levels=LEVELS, error=0.0)
    return np.asarray(session.radiance(EYE))


@case("session", "Radiance through a session's packed sums", ("float32",))
def session(device: Device, size: Size) -> Iterator[Trial]:
    """Against float64, and the same in other units of light, bit for bit."""
    bake, m = _vertices(), Material.parse(SPEC)
    points = vertex_points(bake.mesh, Tracer(bake.mesh.vertices, bake.mesh.faces))
    away = np.asarray(EYE) - bake.mesh.vertices
    view = np.einsum("nij,nj->ni", points.frames.astype(np.float64), away)
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    light, directions = sky(0.0).split(LEVELS), hemisphere.directions(LEVELS).astype(np.float64)
    f = oracle.brdf(m, directions[None, :, :3], view[:, None]) * directions[None, :, 3:]
    passed = gathered(light, points.frames, LEVELS) * world.unpacked(bake.bits, LEVELS)[:, None]
    passed, solid = passed.transpose(0, 2, 1), 2 * np.pi / 4.0**LEVELS
    exact = solid * (passed * f).sum(axis=1)
    packing = 2.0**-9 * passed.max(axis=2, keepdims=True)
    # A view that misses the horizon by a rounding is on either side of it.
    arithmetic = (96 + 64 / ALPHA + 4**LEVELS / 16) * U32 * passed + gather_bound(
        light, points.frames, LEVELS
    ).transpose(0, 2, 1)
    bound = solid * ((packing + arithmetic) * f).sum(axis=1)
    unit = exact.max(axis=1, keepdims=True)
    yield Trial(
        "a sky, against float64",
        lambda: _session(device, sky(0.0)),
        exact,
        bound,
        "2⁻⁹ of each sample's largest channel, and float32's",
        np.where(unit > 0, unit, exact.max()),
        "the vertex's radiance",
        note="a stored mean is right to 2⁻⁹ of its largest channel; errors of a lobe's samples average",
    )
    for what, sun in (("a sky", 0.0), (f"a sky, its sun {SUN:.0e} times as bright", SUN)):
        first = _session(device, sky(sun)).astype(np.float64)
        for power in POWERS[POWERS.index(DIMMEST_SUN) if sun else 0 :]:
            answer = first * 2.0**power
            yield Trial(
                f"{what}, in another unit",
                lambda sun=sun, power=power: _session(device, scaled(sky(sun), power)),  # type: ignore[misc]
                answer,
                0.0 if power > DIMMEST_SUN else 2.0**-149,
                "0: a power of two changes no bit, above 2⁻¹⁴⁹",
                max(float(answer.max()), 1e-300),
                "the largest radiance",
                at=f"brightest {2.0**power:.0e}",
            )
