"""`prtcl stress`: its verdicts, that every case's check can fail, its table, JSON and exit status; small sizes."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import Run

from prtcl.apps.cli import main
from prtcl.apps.stress import command, data, plots, runner, storage, table, transforms
from prtcl.apps.stress.registry import CASES, Case, Size, Trial
from prtcl.apps.stress.runner import RELIABLE, judge, verdict
from prtcl.compute import choice
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.wavelet import haar

SMALL = Size(levels=3, points=70)
TINY = ("--levels", "3", "--points", "70")
Row = dict[str, Any]


@pytest.fixture
def run(run: Run, opencl_device: choice.Seen) -> Run:
    """`prtcl stress` on a device in this process."""
    return partial(run, "stress", "--device", opencl_device.spec)


def trial(**more: Any) -> Trial:
    """One that expects [3, 4] to 1e-6 of its norm."""
    return replace(
        Trial("own", lambda: np.array([[3.0, 4.0]]), [[3.0, 4.0]], 5e-6, "own", 5.0, rows=True), **more
    )


# --- verdicts ------------------------------------------------------------------------------------------------


def test_an_error_is_the_norm_of_its_row_over_the_unit() -> None:
    found = judge(trial(), [[3.0, 4.0 + 4e-6]])
    np.testing.assert_allclose([found.error, found.bound, found.ratio], [8e-7, 1e-6, 0.8], rtol=1e-6)
    assert verdict(trial(), found, True) == "ok"
    each = judge(trial(rows=False, bound=[[1e-6, 5e-6]], unit=1.0), [[3.0 + 2e-6, 4.0 + 4e-6]])
    np.testing.assert_allclose([each.error, each.bound, each.ratio], [4e-6, 5e-6, 2.0], rtol=1e-6)


def test_beyond_the_bound_needs_a_limit_and_a_note() -> None:
    wrong = [[3.0, 4.0 + 4e-5]]
    explained = trial(limit=1e-5, note="why")
    for one, expected in (
        (trial(), "exceeds"),
        (trial(note="why"), "exceeds"),
        (trial(limit=1e-5), "exceeds"),
        (trial(limit=1e-6, note="why"), "exceeds"),
        (explained, "explained"),
    ):
        assert verdict(one, judge(one, wrong), True) == expected
    assert verdict(explained, judge(explained, wrong), False) == "not the same bytes"


def test_a_large_error_needs_a_note_even_within_its_bound() -> None:
    wide = trial(bound=1.0)
    wrong = [[3.0, 4.0 + 10 * RELIABLE]]
    assert verdict(wide, judge(wide, wrong), True) == "exceeds"
    assert verdict(replace(wide, note="why"), judge(wide, wrong), True) == "explained"


@pytest.mark.parametrize("wrong", [[[np.nan, 4.0]], [[3.0, np.inf]], [[3.0, 4.0, 0.0]], [3.0, 4.0]])
def test_what_is_not_finite_or_of_another_shape_is_no_answer(wrong: Any) -> None:
    own = trial(limit=1e9, note="why")
    assert verdict(own, judge(own, wrong), True) == "not finite"


@pytest.mark.parametrize(
    "bad", [{"expected": [[np.inf, 1.0]]}, {"bound": -1.0}, {"bound": np.nan}, {"unit": np.inf}]
)
def test_trials_that_are_no_good_are_refused(bad: Row) -> None:
    with pytest.raises(AssertionError, match="is no number"):
        judge(trial(**bad), [[3.0, 4.0]])


def test_an_exact_bound_of_zero() -> None:
    assert judge(trial(bound=0.0), [[3.0, 4.0]]).ratio == 0.0
    assert judge(trial(bound=0.0), [[3.0, np.nextafter(4.0, 5.0)]]).ratio == math.inf


def test_two_runs_of_other_bytes_are_found(device: Device) -> None:
    count = iter(range(100))
    own = trial(run=lambda: np.array([[3.0, 4.0 + 1e-9 * next(count)]]))
    (row,) = runner.rows(device, Case("own", "own", lambda d, s: iter([own]), ("float32",)), SMALL)
    assert not row["same_bytes"] and row["verdict"] == "not the same bytes"


# --- cases ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_every_case_passes_and_can_fail(device: Device, name: str) -> None:
    """Each trial holds; answers off by a hundredth, turned round, and not finite do not."""
    trials = list(CASES[name].trials(device, SMALL))
    assert trials or name == "albedo"  # which needs 4**7 cells
    for own in trials:
        got = np.asarray(own.run(), dtype=np.float64)
        found = judge(own, got)
        assert verdict(own, found, True) in runner.GOOD, (own.what, own.at, found)
        broken = got.copy()
        broken.flat[np.argmax(np.abs(broken))] = np.nan
        assert verdict(own, judge(own, broken), True) == "not finite"
        size = np.broadcast_to(np.asarray(own.unit, dtype=np.float64), got.shape if not own.rows else
                               (*got.shape[:-1], 1))  # fmt: skip
        size = np.where(size > 0, size, 1.0)
        worst = float(np.max(np.asarray(own.bound) / size))
        off = got + size * max(1.0, own.limit or 0.0, worst) * 10
        assert judge(own, off).ratio > 1 and verdict(own, judge(own, off), True) == "exceeds", own.what


def test_patterns_are_what_they_say() -> None:
    board = data.checkerboard(3)[0]
    # Along rows and columns the sign changes with every step; in Morton order a square is + − − +.
    assert np.sign(board[:4]).tolist() == [1, -1, -1, 1]
    assert len(np.unique(np.abs(board))) == 1
    for kind in data.BRIGHT:
        light, seen = data.light(kind, 3), data.visibility("all but the bright one", 3)
        assert (light.argmax(axis=1) == seen.argmin(axis=1)).all() and seen.sum() == seen.size - 2
    assert (data.visibility("one", 4).sum(axis=1) == 1).all()
    odd = data.adversarial(2, 2.0**-23)
    assert (np.abs(odd) * 2**23 % 2 == 1).all() and (odd == odd.astype(np.float32)).all()


def test_packing_is_that_of_the_kernels() -> None:
    seen = np.zeros((2, 64), dtype=np.bool_)
    seen[0, [0, 33]], seen[1, 31] = True, True
    assert data.packed(seen).tolist() == [[1, 2], [1 << 31, 0]]
    assert data.packed(seen[:1, :4]).tolist() == [[1]]


def test_exact_patterns_leave_no_room(device: Device) -> None:
    bounds = [
        own.bound for own in transforms.transforms(device, SMALL) if own.what.startswith("checkerboard")
    ]
    assert bounds and all(np.all(np.asarray(bound) == 0) for bound in bounds)


def test_a_cost_is_said_for_subnormals(device: Device) -> None:
    own = next(iter(storage.subnormals(device, SMALL)))
    assert ("keeps" in own.note) == storage.keeps_subnormals(device)


def test_build_options_reach_the_compiler(device: Device) -> None:
    other = Device(queue=device.queue, build_options=("-DNO_SUCH_THING=1",))
    samples = np.arange(16.0).reshape(1, 16)
    assert other.build_options == ("-DNO_SUCH_THING=1",) and device.build_options == ()
    first, second = (haar.forward(d, d.array(samples)).get() for d in (device, other))
    assert (first == second).all()


# --- the command ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(opencl_device: choice.Seen, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run of two cases leaves."""
    path = tmp_path_factory.mktemp("stress")
    chosen = ["--cases", "haar", "channels", "--precision", "float32", "--device", opencl_device.spec]
    assert main(["stress", *TINY, *chosen, "--no-plots", "--quiet", "-o", str(path)]) == 0
    return path


def test_results_name_every_trial(folder: Path) -> None:
    result = json.loads((folder / "stress.json").read_text(encoding="utf-8"))
    for name in ("format", "prtcl", "device", "driver", "platform", "date", "command"):
        assert result[name]
    assert {row["case"] for row in result["rows"]} == {"haar", "channels"}
    assert [row["at"] for row in result["rows"] if row["what"] == "lamps, forward"] == [
        "R = 1",
        "R = 2",
        "R = 3",
    ]
    for row in result["rows"]:
        assert row["finite"] and row["same_bytes"] and row["verdict"] in runner.GOOD and row["theory"]
        assert row["note"] or row["error"] <= RELIABLE, "no unexplained row"
    written = (folder / "stress.md").read_text(encoding="utf-8")
    assert written == table.markdown(result)
    for what in {row["what"] for row in result["rows"]}:
        assert f"| {what} |" in written and what in table.text(result)


def test_a_series_is_spoken_for_by_its_worst() -> None:
    rows = [
        {
            "case": "c",
            "what": "w",
            "precision": "float32",
            "at": f"R = {i}",
            "verdict": v,
            "error": e,
            "ratio": r,
            "before": 0.5 * i,
            "before_finite": True,
        }
        for i, (v, e, r) in enumerate([("ok", 0.5, 0.9), ("exceeds", 0.1, 2.0), ("ok", 0.2, 0.1)])
    ]
    (line,) = table.lines(rows)
    assert (line["verdict"], line["error"], line["ratio"]) == ("exceeds", 0.1, 2.0)
    assert line["at"] == "R = 0 … R = 2, here R = 1" and line["before"] == 1.0
    rows[2] |= {"before": None, "before_finite": False}
    (line,) = table.lines(rows)
    assert line["before"] is None and not line["before_finite"], (
        "what overflowed before is not hidden by the rest"
    )


def test_json_and_markdown_and_nothing_else(run: Run) -> None:
    ran = run(*TINY, "--cases", "haar", "--precision", "float32", "--json")
    assert ran.status == 0 and {row["case"] for row in json.loads(ran.out)["rows"]} == {"haar"}
    ran = run(*TINY, "--cases", "haar", "--precision", "float32", "--markdown")
    assert ran.status == 0 and "## Haar transforms of hard patterns" in ran.out


def test_a_wrong_kernel_ends_with_status_1(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = haar.forward

    def corrupted(device: Device, *arguments: Any, **options: Any) -> Any:
        out = honest(device, *arguments, **options).get()
        out.flat[2] += 1e-3
        return device.array(out)

    monkeypatch.setattr(haar, "forward", corrupted)
    ran = run(*TINY, "--cases", "haar", "--precision", "float32")
    assert ran.status == 1 and "exceeds" in ran.out
    assert "prtcl stress: haar, constant, forward at R = 1, float32: exceeds" in ran.err
    assert "inverse" not in ran.err


def test_mistakes_are_named(run: Run) -> None:
    ran = run("--cases", "hair")
    assert ran.status == 2 and "--cases: hair is none" in ran.err and "parent_sums" in ran.err
    assert run("--levels", "2").status == 2
    ran = run(*TINY, "--cases", "session", "--precision", "mixed")
    assert ran.status in (1, 2) and "Traceback" not in ran.err


def test_plots(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    result = json.loads((folder / "stress.json").read_text(encoding="utf-8"))
    written = plots.write(result, tmp_path)
    assert {path.name for path in written} == {"bounds.png", "bounds.svg", "depth.png", "depth.svg"}
    assert all(path.stat().st_size > 5000 for path in written)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match="the plots need matplotlib"):
        command._folder(str(tmp_path), False)
