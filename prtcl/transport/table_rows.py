"""What a bivariate table gives a point's radiance, entry by entry: the rows of the system a fit solves.

Radiance is linear in the table: I = Σ_j (L ⊕ V)_j (W_v f̃)_j + hard light = ⟨W_vᵀ (L ⊕ V) + Σ_l V E_l cos b_l, f̃⟩. The
bracket's left side is a row; it knows the light, the shadows and the view, and nothing of the material.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.chunks import chunk_size, chunks
from prtcl.factors.slice_operator import SliceOperator
from prtcl.factors.visibility import Tracer
from prtcl.transport.collapse import product_samples
from prtcl.transport.pipeline import HARD_CHUNK, Pipeline, Points


def soft_rows(
    pipeline: Pipeline, operator: SliceOperator, tracer: Tracer, points: Points, per_row: int
) -> npt.NDArray[np.float64]:
    """Rows (n, channels, nh · nd) of the soft light, each the mean over `per_row` points that follow each other.

    Parameters
    ----------
    pipeline : of the light; its materials are of no account
    operator : of the table's nodes, at the levels that the pipeline keeps, with the light's channels
    points : n · per_row of them

    Notes
    -----
    The sum is over the cells of 4**keep directions as `collapse` makes them; so a row times a table is what
    `Pipeline.soft` gives for it, but for that one's interpolation between views.
    """
    device, settings, channels = pipeline.device, pipeline.settings, operator.channels
    # A row's sums are no larger than its points' samples, or this bounds them, too.
    samples = per_row * channels * 4**settings.keep * np.dtype(device.dtype).itemsize
    sums = 8 * operator.shape[0] * operator.shape[1] * channels
    size = chunk_size(device, samples + sums, max(samples, sums))
    out = np.empty((len(points) // per_row, channels, operator.shape[0] * operator.shape[1]))
    scale = 2 * np.pi / 4.0**settings.keep / per_row
    for part in chunks(len(out), size):
        some = points[part.start * per_row : part.stop * per_row]
        bits = pipeline.visibility(tracer, some)
        lit = product_samples(device, pipeline.light, bits, some.frames, settings, channels, some.grid)
        rows = operator.rows(part.stop - part.start)
        operator.add_soft(rows, lit, _outgoing(some), per_row, scale)
        out[part] = _fetched(rows, pipeline, channels)
    return out


def hard_rows(
    pipeline: Pipeline, operator: SliceOperator, tracer: Tracer, points: Points, per_row: int
) -> npt.NDArray[np.float64]:
    """As `soft_rows`, of the light's peaks, each traced by itself as an exact direction: `Pipeline.hard`."""
    channels, hard = operator.channels, pipeline.light.hard
    out = np.zeros((len(points) // per_row, channels, operator.shape[0] * operator.shape[1]))
    for part in chunks(len(out) if len(hard) else 0, max(1, HARD_CHUNK // per_row)):
        some = points[part.start * per_row : part.stop * per_row]
        with pipeline.device.profile.host("hard_light_rays"):
            seen = tracer.light_visibility(some.origins, some.frames[:, 2], hard[:, :3])
        rows = operator.rows(part.stop - part.start)
        operator.add_hard(rows, pipeline.light, seen, some.frames, _outgoing(some), per_row, 1.0 / per_row)
        out[part] = _fetched(rows, pipeline, channels)
    return out


def _outgoing(points: Points) -> npt.NDArray[np.float64]:
    out = np.zeros((len(points), 4))
    out[:, :3] = points.views
    return out


def _fetched(rows: Any, pipeline: Pipeline, channels: int) -> npt.NDArray[np.float64]:
    sums = rows.get().reshape(len(rows), -1, channels)
    return np.asarray(pipeline.unit * sums.transpose(0, 2, 1))
