"""Which form of a kernel runs: trials, the tuning file, the device's class."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from prtcl.compute import tuning
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.errors import InputError


@pytest.fixture
def tunable() -> Iterator[Tunable]:
    yield Tunable(
        "test", (Form("plain"), Form("wide", 1), Form("wide", 8)), cpu=Form("wide", 8), gpu=Form("plain")
    )
    del tuning.KNOWN["test"]


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv(tuning.VARIABLE, str(tmp_path / "folder" / "tuning.json"))
    yield tmp_path / "folder" / "tuning.json"
    tuning._entries.cache_clear()


def test_without_a_measurement_the_class_of_the_device_decides(
    device: Device, tunable: Tunable, file: Path
) -> None:
    assert tunable.of(device) == (tunable.cpu if device.takes_vectors else tunable.gpu)
    assert tuning.KNOWN["test"] is tunable


def test_a_measurement_is_kept_for_its_device_alone(device: Device, tunable: Tunable, file: Path) -> None:
    assert tuning.save(device, {"test": Form("wide", 1)}) == file
    assert tunable.of(device) == Form("wide", 1)
    tuning.save(device, {"other": Form("plain")})  # adds, and loses nothing
    assert tunable.of(device) == Form("wide", 1)
    data = json.loads(file.read_text())
    assert list(data) == [tuning.key_of(device)]
    file.write_text(json.dumps({"another device": data[tuning.key_of(device)]}))
    tuning._entries.cache_clear()
    assert tunable.of(device) == (tunable.cpu if device.takes_vectors else tunable.gpu)


def test_a_form_that_is_no_more_is_passed_over(device: Device, tunable: Tunable, file: Path) -> None:
    tuning.save(device, {"test": Form("wide", 99)})
    assert tunable.of(device) in (tunable.cpu, tunable.gpu)


def test_trials_nest_and_end(device: Device, tunable: Tunable, file: Path) -> None:
    tuning.save(device, {"test": Form("wide", 1)})
    with tunable.trial(Form("plain")):
        with tunable.trial(Form("wide", 8)):
            assert tunable.of(device) == Form("wide", 8)
        assert tunable.of(device) == Form("plain")
    assert tunable.of(device) == Form("wide", 1)


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"a": 1}', '{"a": {"b": ["wide"]}}', '{"a": {"b": ["wide", "x"]}}']
)
def test_a_damaged_file_says_what_to_do(device: Device, tunable: Tunable, file: Path, text: str) -> None:
    file.parent.mkdir()
    file.write_text(text)
    with pytest.raises(InputError, match=r"tuning\.json: expected the tuning that prtcl bench --tune writes"):
        tunable.of(device)
    with pytest.raises(InputError, match="delete it"):
        tuning.save(device, {"test": Form("plain")})


def test_no_file_at_all(device: Device, tunable: Tunable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(tuning.VARIABLE, "")
    assert tunable.of(device) in (tunable.cpu, tunable.gpu)
    with pytest.raises(InputError, match="unset it"):
        tuning.save(device, {"test": Form("plain")})
