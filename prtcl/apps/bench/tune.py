"""The auto-tuner: every form of every kernel timed on this device by the stages that run it, the fastest kept."""

from __future__ import annotations

from math import exp, log
from statistics import median

from prtcl.apps.bench.limits import give_back
from prtcl.apps.bench.measure import measure
from prtcl.apps.bench.registry import STAGES
from prtcl.compute.device import Device
from prtcl.compute.tuning import KNOWN, Form

TIMED_BY = {
    "haar": ("forward_haar", "inverse_haar"),
    "reduce": ("dense_reduction",),
    "masked": ("product", "bits_reduction"),
    "sparse": ("sparse_reduction",),
    "environment": ("light",),
    "product": ("light_times_visibility_reduced", "light_times_visibility_packed"),
    "inner_product": ("inner_product",),
    "pixel_product": ("pixel_product",),
}
"""Stages by tunable."""
LEVELS, CHANNELS = (5, 6), 3


def tune(device: Device, points: int, runs: int, memory: float) -> dict[str, tuple[Form, dict[str, float]]]:
    """The best form of each tunable, and seconds relative to it of all forms.

    A form's figure is the geometric mean over stages and levels of its median seconds.
    """
    found = {}
    for name, stages in TIMED_BY.items():
        tunable = KNOWN[name]
        spent = dict.fromkeys(tunable.forms, 0.0)
        for stage in (STAGES[own] for own in stages):
            for levels in LEVELS:
                job = stage.prepare(
                    device, min(points, stage.fits(device, memory, levels, CHANNELS)), levels, CHANNELS
                )
                for form in tunable.forms:
                    with tunable.trial(form):
                        timing, _ = measure(device, job.call, runs=runs, reset=job.reset)
                    spent[form] += log(median(timing.kernels))
                del job
                give_back(device)
        best = min(tunable.forms, key=lambda form: spent[form])
        trials = len(stages) * len(LEVELS)
        ratios = {f"{f.name} {f.size}": exp((spent[f] - spent[best]) / trials) for f in tunable.forms}
        found[name] = best, ratios
    return found
