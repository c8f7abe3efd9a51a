"""Pictures of a table for people: its values over (θ_h, θ_d), as BRDF Explorer shows them, and its lobes."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from prtcl.apps.brdf_plots import tone_mapped
from prtcl.factors.bivariate import Bivariate

WIDTH, MAP_HEIGHT, LOBE_HEIGHT = 460, 350, 300
LEFT, BOTTOM, TOP, RIGHT = 64, 58, 34, 18
"""Margins of each of the two, in pixels."""
BACK, INK, GRID = (26, 27, 30), (193, 194, 197), (64, 66, 72)
INCIDENCES = ((15.0, (255, 193, 94)), (45.0, (110, 190, 255)), (75.0, (240, 128, 170)))
"""Degrees, and the colour of the curve."""
DECADES = 4
"""Of f, below its largest value in the plot."""

Region = tuple[tuple[float, float], tuple[float, float]]


def picture(table: Bivariate, region: Region | None = None) -> npt.NDArray[np.uint8]:
    """The table above, its lobes below: (h, w, 3) sRGB.

    Parameters
    ----------
    region : θ_h and θ_d, from and to in degrees, to draw a frame around
    """
    image = Image.new("RGB", (WIDTH, MAP_HEIGHT + LOBE_HEIGHT), BACK)
    draw = ImageDraw.Draw(image)
    _map(image, draw, table, region)
    _lobes(draw, table)
    return np.asarray(image)


def tone(values: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """f in 1/sr to 8-bit sRGB, as `prtcl brdf` draws it: whatever is brighter than white still differs."""
    return np.rint(255 * tone_mapped(values)).astype(np.uint8)


def _map(image: Image.Image, draw: ImageDraw.ImageDraw, table: Bivariate, region: Region | None) -> None:
    width, height = WIDTH - LEFT - RIGHT, MAP_HEIGHT - TOP - BOTTOM
    h = ((np.arange(width) + 0.5) / width) ** 2 * (np.pi / 2)
    d = (np.arange(height)[::-1] + 0.5) / height * (np.pi / 2)
    image.paste(Image.fromarray(tone(table.evaluate(h[None, :], d[:, None]))), (LEFT, TOP))
    font = _font()
    draw.text((LEFT, 5), "f at each pair of angles", INK, font)
    foot = TOP + height
    for angle in (0, 1, 5, 15, 30, 50, 90):
        x = LEFT + width * math.sqrt(angle / 90)
        draw.line([(x, foot), (x, foot + 6)], INK)
        draw.text((x, foot + 8), f"{angle}", INK, font, anchor="ma")
    for angle in (0, 30, 60, 90):
        y = foot - height * angle / 90
        draw.line([(LEFT - 6, y), (LEFT, y)], INK)
        draw.text((LEFT - 10, y), f"{angle}", INK, font, anchor="rm")
    draw.text((LEFT + width / 2, foot + 32), "half angle, degrees (highlight: left)", INK, font, anchor="ma")
    _sideways(image, "difference angle", (2, TOP, height))
    if region is not None:
        x0, x1 = (LEFT + width * math.sqrt(angle / 90) for angle in region[0])
        y0, y1 = (foot - height * angle / 90 for angle in region[1])
        frame = [x0, y1, max(x1, x0 + 4), max(y0, y1 + 4)]
        # Seen on bright and on dark.
        draw.rectangle(frame, outline=(255, 255, 255), width=4)
        draw.rectangle([frame[0] + 1, frame[1] + 1, frame[2] - 1, frame[3] - 1], outline=(0, 0, 0), width=2)


def _lobes(draw: ImageDraw.ImageDraw, table: Bivariate) -> None:
    """Grey f in the plane of incidence over the angle of reflection, logarithmic."""
    width, height, top = WIDTH - LEFT - RIGHT, LOBE_HEIGHT - TOP - BOTTOM, MAP_HEIGHT + TOP
    out = np.linspace(-89.0, 89.0, 4 * 178 + 1)
    curves = [lobe(table, incidence, out) for incidence, _ in INCIDENCES]
    most = max(float(curve.max()) for curve in curves)
    ceiling = math.ceil(math.log10(most) + 0.05) if most > 0.0 else 0
    font = _font()
    draw.text((LEFT, MAP_HEIGHT + 5), "Lobes, light from", INK, font)
    x = LEFT + draw.textlength("Lobes, light from ", font)
    for incidence, colour in INCIDENCES:
        draw.text((x, MAP_HEIGHT + 5), f"{incidence:.0f}", colour, font)
        x += draw.textlength(f"{incidence:.0f}  ", font)
    draw.text((x, MAP_HEIGHT + 5), "degrees", INK, font)
    for step in range(DECADES + 1):
        y = top + height * step / DECADES
        draw.line([(LEFT, y), (LEFT + width, y)], GRID)
        draw.text((LEFT - 8, y), f"{10.0 ** (ceiling - step):g}", INK, font, anchor="rm")
    for angle in (-90, -45, 0, 45, 90):
        x = LEFT + width * (angle + 90) / 180
        draw.line([(x, top), (x, top + height)], GRID)
        anchor = {-90: "la", 90: "ra"}.get(angle, "ma")
        draw.text((x, top + height + 8), f"{angle}", INK, font, anchor=anchor)
    draw.text(
        (LEFT + width / 2, top + height + 32), "seen from, degrees; f per steradian", INK, font, anchor="ma"
    )
    for curve, (_, colour) in zip(curves, INCIDENCES, strict=True):
        level = np.log10(np.maximum(curve, 10.0 ** (ceiling - 2 * DECADES)))
        y_at = top + height * np.clip((ceiling - level) / DECADES, 0.0, 1.0)
        x_at = LEFT + width * (out + 90) / 180
        draw.line(list(zip(x_at.tolist(), y_at.tolist(), strict=True)), colour, 3, joint="curve")


def lobe(table: Bivariate, incidence: float, out: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Grey f in the plane of incidence: light at −`incidence`, seen from `out`, degrees from the normal: (n,)."""
    half, difference = np.radians(out - incidence) / 2, np.radians(out + incidence) / 2
    return np.asarray(table.evaluate(np.abs(half), np.abs(difference)).mean(axis=-1))


def _sideways(image: Image.Image, text: str, at: tuple[int, int, int]) -> None:
    x, y, height = at
    label = Image.new("RGB", (height, 24), BACK)
    ImageDraw.Draw(label).text((height / 2, 2), text, INK, _font(), anchor="ma")
    image.paste(label.rotate(90, expand=True), (x, y))


def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(19)
