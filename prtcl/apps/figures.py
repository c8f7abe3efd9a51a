"""What all plots share: matplotlib asked for before the work, figures without a screen, files written aside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from prtcl.errors import InputError
from prtcl.files.atomic import replacing


def require(way_out: str = "") -> None:
    """Refuse to begin a run whose pictures could not be made.

    Parameters
    ----------
    way_out : ends the message, such as ", or --no-plots"

    Raises
    ------
    InputError
        If matplotlib is not installed.
    """
    try:
        import_module("matplotlib")
    except ImportError as error:
        raise InputError(
            f"--output: the plots need matplotlib, which is not there ({error})\n"
            f"pip install 'prtcl[plots]'{way_out}"
        ) from error


def new(width: float = 12, height: float = 6.5, layout: Any = "constrained") -> Any:
    """A figure of its own: nothing of pyplot's, which holds on to figures and asks for a screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save(
    figures: Mapping[str, Any], folder: Path, kinds: Sequence[str] = ("png", "svg"), dpi: int = 150
) -> list[Path]:
    """Write figures by name, a file a kind; their paths."""
    written = []
    for name, figure in figures.items():
        for kind in kinds:
            with replacing(folder / f"{name}.{kind}") as aside:
                figure.savefig(aside, dpi=dpi)
            written.append(folder / f"{name}.{kind}")
    return written
