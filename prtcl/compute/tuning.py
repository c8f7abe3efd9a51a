"""Which of a kernel's forms runs on which device: what was measured there, or else what suits its class.

A kernel that has more than one form states them as a `Tunable` beside the code that launches it. Nothing is measured
unless it is asked for (`prtcl bench --tune`): the same input on the same device then gives the same bytes, today and
after the next tuning of another device.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from prtcl.errors import InputError
from prtcl.files.atomic import replacing

if TYPE_CHECKING:
    from prtcl.compute.device import Device

VARIABLE = "PRTCL_TUNING"
"""Names another file than the user's cache; empty: none is read."""


class Form(NamedTuple):
    """One form of a kernel and its one number, such as rows or lanes of a work-item."""

    name: str
    size: int = 1


@dataclass(frozen=True)
class Tunable:
    """A kernel family, the forms it has, and which to take where nothing was measured.

    Attributes
    ----------
    name : as the tuning file has it
    forms : all that may be chosen
    cpu, gpu : of `forms`, by the class of the device (`Device.takes_vectors`)
    """

    name: str
    forms: tuple[Form, ...]
    cpu: Form
    gpu: Form

    def __post_init__(self) -> None:
        KNOWN[self.name] = self

    def of(self, device: Device) -> Form:
        """The form to run on `device`: a trial's, else the tuning file's, else that of its class.

        Raises
        ------
        InputError
            If the tuning file cannot be read.
        """
        trial = _TRIALS.get(self.name)
        if trial is not None:
            return trial
        measured = _entries(_path()).get(key_of(device), {}).get(self.name)
        if measured in self.forms:
            return measured
        return self.cpu if device.takes_vectors else self.gpu

    @contextmanager
    def trial(self, form: Form) -> Iterator[None]:
        """Run a block with one form, whatever is on file."""
        outer = _TRIALS.get(self.name)
        _TRIALS[self.name] = form
        try:
            yield
        finally:
            del _TRIALS[self.name]
            if outer is not None:
                _TRIALS[self.name] = outer


_TRIALS: dict[str, Form] = {}
KNOWN: dict[str, Tunable] = {}
"""All tunables of the modules that were imported, by name."""


def forms_of(device: Device) -> dict[str, Form]:
    """The form in which each kernel runs on a device."""
    return {name: tunable.of(device) for name, tunable in KNOWN.items()}


def key_of(device: Device) -> str:
    """What a measurement holds for: platform, device and driver."""
    return f"{device.platform} / {device.name} / {device.driver}"


def cache_path() -> Path:
    """The user's tuning file, whether or not it is there."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "prtcl" / "tuning.json"


def _path() -> Path | None:
    given = os.environ.get(VARIABLE)
    if given is None:
        return cache_path()
    return Path(given) if given else None


@cache
def _entries(path: Path | None) -> dict[str, dict[str, Form]]:
    """All that is on file: the shipped measurements, and over them the user's own."""
    found: dict[str, dict[str, Form]] = {}
    for file in (Path(__file__).with_name("tuned.json"), path):
        if file is None or not file.is_file():
            continue
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            for device, forms in data.items():
                found.setdefault(device, {}).update({k: Form(str(v[0]), int(v[1])) for k, v in forms.items()})
        except (OSError, ValueError, TypeError, AttributeError, LookupError) as error:
            reason = re.sub(r"\s+", " ", str(error))
            raise InputError(
                f"{file}: expected the tuning that prtcl bench --tune writes ({reason})\n"
                f"delete it and run that again, or set {VARIABLE} to nothing to do without"
            ) from error
    return found


def save(device: Device, forms: dict[str, Form]) -> Path:
    """Keep what was measured for a device in the user's tuning file; returns its path.

    Raises
    ------
    InputError
        If `PRTCL_TUNING` is set to nothing: there is no file then; or if the file that is there is damaged.
    """
    path = _path()
    if path is None:
        raise InputError(
            f"{VARIABLE}: is set to nothing, so there is no file to keep the tuning in\nunset it"
        )
    _entries.cache_clear()
    _entries(path)  # a file that cannot be read is not written over
    data = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    data[key_of(device)] = {**data.get(key_of(device), {}), **{k: list(v) for k, v in forms.items()}}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as aside:
        aside.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    _entries.cache_clear()
    return path
