"""Pictures of a report: settings and their frontier, factors by themselves, time and memory by stage, where it errs."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.apps import figures

Row = dict[str, Any]
LABELS = {
    "light": ("levels", "light: levels of directions"),
    "visibility": ("rays", "visibility: levels of rays"),
    "reflectance": ("keep", "reflectance: levels kept of f_v"),
    "view": ("views", "view: stored angles"),
}
WITH_HARD = ("hard_light_rays", "shade_lights")


def settings(told: Row) -> Any:
    """Every setting's error against its time, the frontier, and the plan's picture."""
    figure = figures.new(9, 6)
    axes = figure.add_subplot()
    for number, rays in enumerate(sorted({row["rays"] for row in told["settings"]})):
        own = [row for row in told["settings"] if row["rays"] == rays]
        axes.loglog(
            [row["seconds"] for row in own], [100 * row["error"] for row in own], "o", color=f"C{number}", alpha=0.6,
            label=f"4^{rays} rays",
        )  # fmt: skip
    front = told["frontier"]
    axes.loglog(
        [row["seconds"] for row in front], [100 * row["error"] for row in front], "-", color="black", lw=1,
        label="frontier of fixed points a pixel",
    )  # fmt: skip
    plan = told["plan"]
    label = "usual settings: the error is refused" if "refused" in plan else "planned, its pilot included"
    # What lies below the reference's noise may come out as 0, which has no place on the axis.
    found = max(plan["found"], 0.5 * told["reference_noise"])
    axes.loglog([plan["seconds"]], [100 * found], "*", color="red", ms=16, label=label)
    axes.axhline(100 * plan["asked"], color="red", ls=":", lw=1, label="asked for")
    axes.axhline(100 * told["reference_noise"], color="grey", ls=":", lw=1, label="noise of the reference")
    axes.set_xlabel("seconds, expected of the whole picture (planned: measured)")
    axes.set_ylabel("relative RMSE, %")
    axes.set_title(told["material"], wrap=True)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    return figure


def factors(told: Row) -> Any:
    """What approximating light, visibility, reflectance or view alone costs a point."""
    figure = figures.new(12, 3.6)
    for axes, (name, rows) in zip(
        figure.subplots(1, len(LABELS), sharey=True), told["factors"].items(), strict=True
    ):
        key, label = LABELS[name]
        # Zero has no place on the axis: what is exact ends the curve.
        own = [row for row in rows if row["error"] > 0.0]
        axes.plot([row[key] for row in own], [100 * row["error"] for row in own], "o-")
        axes.set_yscale("log")
        if name == "view":
            axes.set_xscale("log", base=2)
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("relative RMSE of points, %")
    return figure


def stages(told: Row) -> Any:
    """Time and memory of the planned picture by stage."""
    figure = figures.new(12, 3.6)
    time_axes, memory_axes = figure.subplots(1, 2)
    seconds = {k: v for k, v in told["render"]["seconds"].items() if k != "total" and v > 0.0}
    each = told["render"]["bytes_per_point"]
    for axes, values, label in (
        (time_axes, seconds, "seconds (kernels and the host's share overlap)"),
        (memory_axes, each, "bytes a point on the device"),
    ):
        ordered = sorted(values.items(), key=lambda pair: pair[1])
        axes.barh([name.replace("_", " ") for name, _ in ordered], [value for _, value in ordered])
        axes.set_xlabel(label)
    return figure


def error_picture(image: npt.NDArray[np.float32], error: npt.NDArray[np.float32]) -> Any:
    """The picture and where it errs: the expected error of each pixel over the picture's mean radiance."""
    figure = figures.new(12, 12 * image.shape[0] / image.shape[1] / 2 + 0.6)
    seen_axes, error_axes = figure.subplots(1, 2)
    colour, alpha = image[..., :3].astype(np.float64), image[..., 3:]
    seen = image[..., 3] > 0.0
    mean = colour[seen].mean() if seen.any() else 1.0
    shown = np.clip(colour / max(4.0 * mean, 1e-300), 0.0, 1.0) ** (1 / 2.2) + (1.0 - alpha)
    seen_axes.imshow(np.clip(shown, 0.0, 1.0))
    relative = np.where(seen, 100 * error / max(mean, 1e-300), np.nan)
    drawn = error_axes.imshow(relative, cmap="magma", vmin=0.0, vmax=float(np.nanpercentile(relative, 99)))
    figure.colorbar(drawn, ax=error_axes, label="expected error, % of the picture's mean", shrink=0.8)
    for axes in (seen_axes, error_axes):
        axes.set_axis_off()
    return figure
