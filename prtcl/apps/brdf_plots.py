"""Pictures of a BRDF: its (θ_h, θ_d) image, its lobes, its albedo against the angle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.apps import figures
from prtcl.factors.bivariate import directions
from prtcl.factors.material import MEASURED
from prtcl.factors.measured import Measured
from prtcl.factors.reduction import Brdf, in_two_angles
from prtcl.factors.sampled_albedo import sampled_albedo
from prtcl.files.image import srgb

Array = npt.NDArray[np.float64]
INCIDENCE = (10.0, 30.0, 50.0, 65.0)
"""Degrees from the normal of the lobes that are drawn."""
SIDE = 180
"""Pixels of the image along each axis: half a bin of MERL's."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Rec. 709."""


def write(name: str, f: Brdf, measured: Measured | None, folder: Path) -> list[Path]:
    """Write image.png, lobes.png and albedo.png."""
    figures.require()
    made = {"image": _image(name, f, measured), "lobes": _lobes(name, f), "albedo": _albedo(name, f)}
    return figures.save(made, folder, ("png",), 130)


def slice_image(f: Brdf, side: int = SIDE, phi_d: float = np.pi / 2) -> Array:
    """f over θ_h to the right, evenly in √θ_h, and θ_d up, at one φ_d: (side, side, 3), row 0 at the largest θ_d.

    The axes of MERL's layout and of Disney's BRDF Explorer. At φ_d = 90° both directions are above the horizon
    everywhere.
    """
    steps = (np.arange(side) + 0.5) / side
    i, o = directions(steps**2 * (np.pi / 2), steps[::-1, None] * (np.pi / 2), phi_d)
    return f(i.reshape(-1, 3), o.reshape(-1, 3)).reshape(side, side, 3)


def tone_mapped(values: Array) -> Array:
    """For display: π f, which is 1 for a white diffuse surface, through x/(1 + x) to sRGB in [0, 1]."""
    scaled = np.pi * np.maximum(values, 0.0)
    return srgb(scaled / (1 + scaled))


def lobe(f: Brdf, incidence: float, angles: Array) -> Array:
    """Luminance of f in the plane of incidence, at signed angles from the normal; the mirror direction is positive."""
    incident = np.array([-np.sin(incidence), 0.0, np.cos(incidence)])
    outgoing = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
    return np.asarray(f(np.broadcast_to(incident, outgoing.shape), outgoing) @ LUMINANCE)


def _image(name: str, f: Brdf, measured: Measured | None) -> Any:
    """The slice at φ_d = 90°, and beside it what two angles keep, where they are fewer."""
    panels = [("φ_d = 90°", slice_image(f))]
    if measured is not None:
        panels.append(("mean over φ_d", slice_image(in_two_angles(measured.bivariate()))))
    figure = figures.new(1.2 + 4.6 * len(panels), 5.2)
    ticks = np.array([0, 1, 5, 15, 30, 45, 60, 75, 90])
    for number, (title, values) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), number + 1)
        axes.imshow(tone_mapped(values), extent=(0, 1, 0, 90), aspect=1 / 90, interpolation="nearest")
        axes.set_xticks(np.sqrt(ticks / 90), [str(t) for t in ticks])
        axes.set_yticks([0, 15, 30, 45, 60, 75, 90])
        axes.set_xlabel("θ_h, degrees, even in √θ_h")
        axes.set_ylabel("θ_d, degrees")
        axes.set_title(title)
    figure.suptitle(_short(name))
    return figure


def _lobes(name: str, f: Brdf) -> Any:
    """Cube root of f's luminance against the outgoing angle, a curve an incidence: a lobe and its base both show."""
    figure = figures.new(8, 4.9, None)
    axes = figure.add_axes((0.06, 0.02, 0.88, 0.98), projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_thetamin(-90)
    axes.set_thetamax(90)
    for number, degrees in enumerate(INCIDENCE):
        angle = np.radians(degrees)
        # Denser about the mirror direction, where a sharp lobe is; not at it, since a fit's f may jump there.
        close = angle + np.linspace(-0.1, 0.1, 400)
        grid = np.sort(np.concatenate([np.linspace(-1.565, 1.565, 721), close[np.abs(close) < 1.565]]))
        axes.plot(
            grid, np.cbrt(lobe(f, angle, grid)), color=f"C{number}", label=f"{degrees:g}°", linewidth=1.2
        )
        axes.axvline(-angle, color=f"C{number}", linestyle=":", linewidth=1.0)
    axes.set_rticks(axes.get_yticks()[::2])  # more labels run into each other
    figure.suptitle(f"{_short(name)}: ∛ of f's luminance in the plane of incidence")
    figure.legend(loc="lower center", title="light from (dotted)", ncols=len(INCIDENCE))
    return figure


def _albedo(name: str, f: Brdf) -> Any:
    figure = figures.new(7, 4.5)
    axes = figure.add_subplot()
    degrees = np.concatenate([np.linspace(0, 80, 17), np.linspace(81, 88, 8)])
    curves = sampled_albedo(f, np.radians(degrees), samples=64)
    for channel, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
        axes.plot(degrees, curves[:, channel], color=colour, marker=".", label="RGB"[channel])
    axes.axhline(1.0, color="black", linewidth=0.8, linestyle="--")
    axes.set_ylim(0, max(1.05, 1.05 * float(curves.max())))
    axes.set_xlabel("outgoing direction, degrees from the normal")
    axes.set_ylabel("albedo")
    axes.set_title(_short(name))
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _short(name: str) -> str:
    """A SPEC with its file's name only; one of numbers, r/g/b among them, as it is."""
    kind, colon, rest = name.partition(":")
    return f"{kind}{colon}{Path(rest).name}" if kind in (*MEASURED, "table") else name
