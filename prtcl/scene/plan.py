"""A plan: the settings that a scene is rendered with, what they are expected to err, and why these."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass, field
from typing import Any

from prtcl._version import __version__
from prtcl.errors import InputError
from prtcl.files.atomic import replacing
from prtcl.transport.settings import Settings

FORMAT = 1


def check_error(error: float) -> None:
    """Refuse an error that no picture can be asked for.

    Raises
    ------
    InputError
        If it is not between 0 and 1.
    """
    if not 0.0 < error < 1.0:
        raise InputError(f"error: expected a relative error between 0 and 1, such as 0.01, got {error}")


@dataclass(frozen=True)
class Trial:
    """One candidate of a pilot.

    Attributes
    ----------
    name : which resolutions it has, in words
    bias : relative error that stays however many points a pixel gets; 0 where none could be told
    bias_uncertain : one standard error of its square, square root taken
    noise : relative error of a mean of sixteen points of soft light
    seconds : that the image is expected to take with it; None where it does not meet the error
    """

    name: str
    bias: float
    bias_uncertain: float
    noise: float
    seconds: float | None


@dataclass(frozen=True)
class Plan:
    """Settings for every material of a scene, chosen for an error.

    Attributes
    ----------
    asked : relative RMSE asked for
    settings : one for each material
    points : "pixel" or "vertex", what the settings are for
    bias : relative error that no number of points takes away, as the pilot measured it against float64
    bias_uncertain : one standard error of its square, square root taken
    predicted : relative error expected of the image
    confidence : that the image errs by no more than was asked, 0 to 1
    seconds : the image is expected to take
    pilot_seconds : that finding out took
    noise_ratio : squared error of a pixel over what its points' variance says (`prtcl.scene.film`)
    steered : whether `pixel_error` and `noise_ratio` come from an image rendered with this plan, and not from the
        pilot alone
    trials : the candidates
    scene : names of mesh, environment and materials
    device : that times were measured on
    """

    asked: float
    settings: tuple[Settings, ...]
    points: str
    bias: float
    bias_uncertain: float
    predicted: float
    confidence: float
    seconds: float
    pilot_seconds: float
    noise_ratio: float = 1.0
    steered: bool = False
    trials: tuple[Trial, ...] = ()
    scene: dict[str, Any] = field(default_factory=dict)
    device: str = ""

    def doubt(self, scene: dict[str, Any], by_hand: bool) -> str | None:
        """Why a picture need not err by what is `predicted`, in words; None where it should.

        Parameters
        ----------
        scene : names of the picture's mesh, environment and materials
        by_hand : whether something in place of the plan's was fixed for it
        """
        for name, was in self.scene.items():
            if scene[name] != was:
                return f"the plan was made for the {name} {was}"
        return "something was fixed by hand in place of the plan's" if by_hand else None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write JSON, aside and then renamed."""
        with replacing(path) as aside:
            own = {**asdict(self), "settings": [settings.plain() for settings in self.settings]}
            text = json.dumps({"format": FORMAT, "prtcl": __version__, **own}, indent=1)
            aside.write_text(text + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Plan:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, is no plan, or of another format.
        """
        name = os.fspath(path)
        try:
            with open(path, encoding="utf-8") as file:
                data = json.load(file)
            if data.pop("format") != FORMAT:
                raise InputError(f"{name}: a plan of another format; make it again with --save-plan")
            data.pop("prtcl")
            settings = tuple(
                Settings(**{**own, "leave_out": frozenset(own["leave_out"])}) for own in data.pop("settings")
            )
            trials = tuple(Trial(**own) for own in data.pop("trials"))
            plan = cls(settings=settings, trials=trials, **data)
            if not settings or not plan._sound():
                raise ValueError
        except OSError as error:
            raise InputError(f"{name}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{name}: is no plan; make one with prtcl render --error E --save-plan FILE"
            ) from error
        return plan

    def _sound(self) -> bool:
        """Whether fields are of their kinds and ranges, whoever wrote them."""
        shares = (self.bias, self.bias_uncertain, self.predicted, self.noise_ratio)
        numbers = [self.asked, self.confidence, self.seconds, self.pilot_seconds, *shares]
        for trial in self.trials:
            numbers += [trial.bias, trial.bias_uncertain, trial.noise, trial.seconds or 0.0]
        return (
            all(
                isinstance(own, int | float) and not isinstance(own, bool) and 0.0 <= own < math.inf
                for own in numbers
            )
            and 0.0 < self.asked < 1.0
            and self.confidence <= 1.0
            and self.points in ("pixel", "vertex")
            and isinstance(self.steered, bool)
            and isinstance(self.device, str)
            and isinstance(self.scene, dict)
            and self.scene.keys() <= {"mesh", "environment", "materials"}
        )

    def summary(self) -> dict[str, Any]:
        """What a report says of it."""
        names = (
            "asked",
            "predicted",
            "confidence",
            "bias",
            "bias_uncertain",
            "noise_ratio",
            "seconds",
            "pilot_seconds",
        )
        return {
            **{name: getattr(self, name) for name in names},
            "trials": [asdict(trial) for trial in self.trials],
        }

    def explain(self) -> list[str]:
        """What was chosen and why, a line each."""
        lines = [
            f"asked for {100 * self.asked:.3g} %, expected {100 * self.predicted:.2g} % "
            f"(within what was asked with {100 * self.confidence:.0f} % confidence) in {self.seconds:.1f} s; "
            f"the pilot took {self.pilot_seconds:.1f} s",
            f"bias against float64 {_percent(self.bias)}, told to {_percent(self.bias_uncertain)}",
        ]
        for trial in self.trials:
            takes = "is not enough" if trial.seconds is None else f"{trial.seconds:.1f} s"
            bias = f"bias {_percent(trial.bias)} ± {_percent(trial.bias_uncertain)}"
            noise = f", noise of 16 points {_percent(trial.noise)}" if self.points == "pixel" else ""
            lines.append(f"tried {trial.name}: {bias}{noise}: {takes}")
        return lines


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
