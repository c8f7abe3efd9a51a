"""The same answer whatever the order, the form of a kernel and the points' company; and what fast-math changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from prtcl import bounds
from prtcl.apps.stress import data, oracle
from prtcl.apps.stress.light import COUNT, NODES, SUN, Scene
from prtcl.apps.stress.light import LEVELS as SCENE_LEVELS
from prtcl.apps.stress.oracle import OWN, Array, reference
from prtcl.apps.stress.products import product, product_bound
from prtcl.apps.stress.reflectance import given
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute import tuning
from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials, ViewTable
from prtcl.transport import collapse, shade
from prtcl.transport.pipeline import Pipeline
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, triple

LEVELS = 5
PART = 1 << 15
"""Points of a part of the million."""
FAST = ("-cl-mad-enable", "-cl-denorms-are-zero", "-cl-fast-relaxed-math")


@case("identical", "Points of identical data", ("float32",))
def identical(device: Device, size: Size) -> Iterator[Trial]:
    """One point's answer, bit for bit, at every place in every work-group and part."""
    scene = Scene(SUN)
    settings, light = (
        Settings(SCENE_LEVELS, SCENE_LEVELS, SCENE_LEVELS, views=NODES),
        scene.sky.split(SCENE_LEVELS),
    )
    table = ViewTable.make(True, NODES)
    slices = Materials(device, [scene.material]).slices(table.views, SCENE_LEVELS)[0]
    some = scene.points[np.zeros(PART, dtype=np.int64)]
    index, weight = table.locate(some.views)
    bits = np.repeat(scene.bits[:1], PART, axis=0)

    def run() -> Array:
        out = np.empty((size.points, 4), dtype=device.dtype)
        for first in range(0, size.points, PART):
            n = min(PART, size.points - first)
            reduced = collapse.reduced_coefficients(device, light, bits[:n], some.frames[:n], settings)
            out[first : first + n] = shade.soft_radiance(
                device, reduced, slices, index[:n], weight[:n], SCENE_LEVELS
            ).get()
        return out

    one = collapse.reduced_coefficients(device, light, bits[:1], some.frames[:1], settings)
    alone = shade.soft_radiance(device, one, slices, index[:1], weight[:1], SCENE_LEVELS).get()
    yield Trial(
        f"{size.points:,} points, each against one alone",
        run,
        np.broadcast_to(alone.astype(np.float64), (size.points, 4)),
        0.0,
        "0: the same bytes",
        float(alone.max()),
        "the radiance",
        at=f"R = {SCENE_LEVELS}",
    )


@case("order", "Points in another order and in other parts")
def order(device: Device, size: Size) -> Iterator[Trial]:
    """Nothing of a point's answer depends on the points beside it."""
    scene = Scene(SUN)
    straight = scene.rendered(device, 0).astype(np.float64)
    shuffled = np.random.default_rng(3).permutation(COUNT)

    def turned() -> Array:
        pipeline = Pipeline(device, scene.sky, [scene.material], scene.settings)
        return np.asarray(pipeline.radiance(scene.tracer, scene.points[shuffled], scene.bits[shuffled]))

    def parted() -> Array:
        pipeline = Pipeline(device, scene.sky, [scene.material], scene.settings, budget=PART)
        return np.asarray(pipeline.radiance(scene.tracer, scene.points, scene.bits))

    for what, job, answer in (
        ("points shuffled", turned, straight[shuffled]),
        ("parts as small as they come", parted, straight),
    ):
        yield Trial(what, job, answer, 0.0, "0: the same bytes", float(straight.max()), "the radiance")


def _jobs(device: Device, levels: int) -> dict[str, tuple[Callable[[], Array], Array, Array, str]]:
    """By tunable: a job, its float64 answer, the bound of its error in the norm of a row, and that in words."""
    samples, seen = data.light("lamps", levels), data.visibility("horizon", levels)
    own, bits = device.array(samples[:, None]), data.packed(seen)
    exact = reference.haar(samples * seen)[:, None]
    u = bounds.STORED[device.precision] + OWN
    coefficients = reference.haar(samples).astype(device.dtype).astype(np.float64)
    slices = np.random.default_rng(4).uniform(0.2, 1.0, (3, 1, 4**levels)).astype(np.float32)
    index, weight = np.array([[0, 1], [2, 1]], dtype=np.int32), np.array([[0.25, 0.75], [0.5, 0.5]])
    scale = 2 * np.pi / 4.0**levels
    terms = scale * (weight[..., None] * slices[index][:, :, 0]) * coefficients[:, None]
    radiance = np.repeat(terms.sum(axis=(1, 2))[:, None], 4, axis=1)
    radiance[:, 3] = 0.0

    def inner() -> Array:
        given = device.array(coefficients[:, None]), device.array(slices)
        return np.asarray(shade.soft_radiance(device, *given, index, weight, levels).get())

    tree = product_bound("bits", samples, seen, levels, device.precision)[:, None]
    pixel = product_bound("pixel", samples, seen, levels, device.precision)[:, None]
    # The fewest lanes have the longest sums; errors of three equal channels together are √3 of one's.
    longest = bounds.inner_product(terms.reshape(2, -1), levels, 4, 2, device.precision)[:, None] * 3**0.5
    return {
        "haar": (
            lambda: haar.forward(device, own).get(),
            reference.haar(samples)[:, None],
            bounds.haar(levels, u, samples)[:, None],
            "2 R u ‖x‖₂",
        ),
        "reduce": (lambda: _tree(device, own, bits, levels), exact, tree, "as in the products"),
        "masked": (partial(_product, device, "pixel", own, bits, levels), exact, pixel, "(2 R + 1) u ‖L V‖₂"),
        "sparse": (partial(_product, device, "in place", own, bits, levels), exact, tree, "as in the products"),
        "inner_product": (inner, radiance, longest, "k u Σ |c_j f_j|, k of the longest run of additions"),
    }  # fmt: skip


def _product(device: Device, form: str, own: Any, bits: Any, levels: int) -> Array:
    return product(device, form, own, bits, levels)


def _tree(device: Device, own: Any, bits: Any, levels: int) -> Array:
    from prtcl.wavelet import masked

    seen = masked.visibility_coefficients(device, bits, levels)
    return np.asarray(triple.reduce(device, haar.forward(device, own), seen).get())


@case("forms", "Every form of every kernel, every size of work-group")
def forms(device: Device, size: Size) -> Iterator[Trial]:
    """What `prtcl bench --tune` chooses among: sums in other orders, each within the bound."""
    levels = min(LEVELS, size.levels)
    for name, (job, exact, bound, theory) in _jobs(device, levels).items():
        tunable = tuning.KNOWN[name]
        for form in tunable.forms:
            if form.name == "wide" and not device.takes_vectors:
                continue

            def run(tunable: tuning.Tunable = tunable, form: tuning.Form = form, job: Any = job) -> Array:
                with tunable.trial(form):
                    return np.asarray(job())

            yield Trial(
                f"{name.replace('_', ' ')}: every form",
                run,
                exact,
                bound,
                theory,
                bounds.norms(exact),
                "‖answer‖₂ of a row",
                at=f"{form.name} {form.size}",
                rows=True,
            )


@case("fast_math", "The compiler's options: fast-math, subnormals as zeros")
def fast_math(device: Device, size: Size) -> Iterator[Trial]:
    """The same jobs built with each; `before` is the error as prtcl builds them, without."""
    levels = min(LEVELS, size.levels)
    for option in FAST:
        other = Device(queue=device.queue, precision=device.precision, build_options=(option,))
        plain, fast = _jobs(device, levels), _jobs(other, levels)
        for name in plain:
            job, exact, bound, theory = fast[name]
            yield Trial(
                f"{name.replace('_', ' ')}, {option}",
                job,
                exact,
                bound,
                theory,
                bounds.norms(exact),
                "‖answer‖₂ of a row",
                rows=True,
                before=plain[name][0],
            )
        for spec in ("ggx:alpha=0.001,f0=1", "blinn:exponent=100000,ks=1"):
            own = Material.parse(spec)
            i, o = given(device, "near the mirror")
            answer = oracle.brdf(own, i, o)
            yield Trial(
                f"f of {spec}, {option}",
                lambda d=other, m=own, i=i, o=o: Materials(d, [m]).evaluate(0, i, o),  # type: ignore[misc]
                answer,
                oracle.brdf_bound(own, i, o, bounds.STORED[device.precision]),
                "that of f",
                np.where(answer > 1e-30, answer, answer.max()),
                "f",
                limit=1e-2 if device.precision != "float64" else 1e-6,
                note="fast-math's exp and log promise nothing; prtcl builds without it",
                before=lambda m=own, i=i, o=o: Materials(device, [m]).evaluate(0, i, o),  # type: ignore[misc]
            )
