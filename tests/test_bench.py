"""`prtcl bench`: its limits' kernels, its figures, its checks, its comparison. Nothing here asserts a time."""

from __future__ import annotations

import copy
import json
import math
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import Run

from prtcl.apps.bench import command, compare, costs, limits, measure, plots, table, tune, world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.registry import STAGES, Job, Stage
from prtcl.apps.bench.rivals import RIVALS
from prtcl.apps.bench.runner import Limits, rows
from prtcl.apps.cli import main
from prtcl.compute import choice, tuning
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.wavelet import haar, masked

POINTS, LEVELS = 70, 3
"""More than a work-group; the fewest levels that every form of every kernel takes."""
Row = dict[str, Any]


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    """Copies of a moment."""
    patch = pytest.MonkeyPatch()
    patch.setattr(limits, "LARGEST", 1 << 20)
    patch.setattr(limits, "ITERATIONS", 64)
    patch.setattr(limits, "CHAINS", ((1, 8), (64, 2)))
    yield
    patch.undo()


@pytest.fixture
def run(run: Run, opencl_device: choice.Seen) -> Run:
    """`prtcl bench` on a device in this process."""
    return partial(run, "bench", "--device", opencl_device.spec)


TINY = ("--points", str(POINTS), "--levels", str(LEVELS))


@pytest.fixture(scope="module")
def folder(opencl_device: choice.Seen, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a run of all stages leaves."""
    path = tmp_path_factory.mktemp("bench")
    more = ["--device", opencl_device.spec, "--no-plots", "--quiet", "--channels", "1", "3", "-o", str(path)]
    assert main(["bench", *TINY, *more]) == 0
    return path


@pytest.fixture
def result(folder: Path) -> Row:
    found: Row = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    return found


# --- the limits' kernels -------------------------------------------------------------------------------------


def test_every_copy_copies(device: Device) -> None:
    rows_, row = 3, 64
    values = np.random.default_rng(0).normal(size=rows_ * row).astype(np.float32)
    kernels = device.kernels("limits.cl", GROUP=64, ROW=row)
    for name, width, group in limits.COPIES:
        width = row if width == limits.ROW else width
        source, target = device.array(values), device.array(np.zeros_like(values))
        device.launch(kernels[name], values.size // width, group, source, target, values.size // width)
        assert (target.get() == values).all(), name


def test_multiply_adds_are_done(device: Device) -> None:
    """x <- f x + o from x = item + k, sixteen times a chain: f^n x + o (f^n - 1) / (f - 1)."""
    chains, iterations = 4, 5
    kernel = device.kernels("limits.cl", GROUP=1, ROW=64, ACCUMULATORS=chains)["multiply_adds"]
    out = device.empty((3,))
    device.launch(kernel, 3, 1, out, 0.5, 2.0, iterations)
    grown = 0.5**iterations
    start = np.arange(3)[:, None] + np.arange(chains)
    expected = 16 * (grown * start + 2.0 * (grown - 1) / (0.5 - 1)).sum(axis=1)
    np.testing.assert_allclose(out.get(), expected, rtol=1e-6)


# --- figures -------------------------------------------------------------------------------------------------


def test_every_stage_has_its_figures(result: Row, opencl_device: choice.Seen) -> None:
    for name in ("prtcl", "device", "driver", "platform", "date", "cpus", "command", "limits"):
        assert result[name]
    assert result["device"] == opencl_device.name and result["command"].startswith("prtcl bench")
    found = result["rows"]
    assert {row["stage"] for row in found} == set(STAGES)
    assert len(found) == sum(1 if stage.grey else 2 for stage in STAGES.values())
    for row in found:
        assert row["correct"] and row["points"] == POINTS and row["levels"] == LEVELS
        limited = () if STAGES[row["stage"]].host else ("share_of_copy", "share_of_best_copy", "share_of_fma",
                                                        "share_of_limit")  # fmt: skip
        for key in ("points_per_second", "coefficients_per_second", "bytes", "flops", "copy_bytes_per_second",
                    *limited):  # fmt: skip
            assert math.isfinite(row[key]) and row[key] > 0, (row["stage"], key)
        assert row["bound"] == ("host" if not limited else row["bound"]) in ("memory", "arithmetic", "host")
        spread = row["seconds"]
        assert 0 < spread["min"] <= spread["median"] <= spread["max"]


def test_tables_name_every_stage(result: Row, folder: Path) -> None:
    written = (folder / "bench.md").read_text(encoding="utf-8")
    assert written == table.markdown(result)
    for stage in STAGES.values():
        assert f"| {stage.title} |" in written and stage.title in table.text(result)


def test_json_and_nothing_else(run: Run) -> None:
    ran = run(*TINY, "--stages", "forward_haar", "--json")
    assert ran.status == 0 and [row["stage"] for row in json.loads(ran.out)["rows"]] == ["forward_haar"]


@pytest.mark.parametrize("channels", [1, 3])
def test_costs_are_positive_and_grow(channels: int) -> None:
    def all_costs(size: Size) -> list[float]:
        seen = size.points * size.samples // 2
        found = [
            costs.visibility(size), costs.bits_to_coefficients(size), costs.light(size), costs.pack(size),
            costs.light_times_visibility(size, seen), costs.light_times_visibility_reduced(size, seen),
            costs.light_times_visibility_packed(size, seen), costs.haar(size), costs.parent_sums(size),
            costs.reduction(size), costs.product(size), costs.slices(size, 1), costs.inner_product(size, 9),
            costs.cut(size, 10 * size.points), costs.job(size, seen, 9),
        ]  # fmt: skip
        return [number for cost in found for number in cost]

    base = all_costs(Size(50, 4, channels))
    assert all(math.isfinite(x) and x > 0 for x in base)
    assert all(a < b for a, b in zip(base, all_costs(Size(51, 4, channels)), strict=True))
    assert all(a <= b for a, b in zip(base, all_costs(Size(50, 5, channels)), strict=True))
    assert all(a <= b for a, b in zip(base, all_costs(Size(50, 4, 3)), strict=True))


def test_a_transform_moves_and_does_what_it_says() -> None:
    """Level 1: four values in and out, eight additions."""
    assert costs.haar(Size(10, 1, 1)) == (10 * 2 * 4 * 4, 10 * 8)


# --- checks --------------------------------------------------------------------------------------------------


def test_a_wrong_result_is_found(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = masked.reduce_samples

    def corrupted(device: Device, *arguments: Any) -> Any:
        out = honest(device, *arguments).get()
        out[2, 0, 1] += 1.0
        return device.array(out)

    monkeypatch.setattr(masked, "reduce_samples", corrupted)
    ran = run(*TINY, "--stages", "product", "forward_haar")
    assert ran.status == 1 and "WRONG" in ran.out
    assert "product at 70 points" in ran.err and "is wrong" in ran.err and "forward_haar" not in ran.err


def test_results_that_are_not_finite_are_wrong(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = haar.forward
    monkeypatch.setattr(
        haar, "forward", lambda device, *a, **k: device.array(honest(device, *a, **k).get() * np.nan)
    )
    ran = run(*TINY, "--stages", "forward_haar", "--json")
    assert ran.status == 1 and "not finite" in ran.err
    assert json.loads(ran.out)["rows"][0]["error"] is None


# --- parts ---------------------------------------------------------------------------------------------------


def limits_of(device: Device) -> Limits:
    return Limits.of(device)


@pytest.mark.parametrize("name", ["forward_haar", "visibility"])
def test_more_points_than_fit_go_in_parts(device: Device, name: str) -> None:
    stage = STAGES[name]
    row_bytes = (1 if stage.grey else 3) * 4**LEVELS * 4
    memory = 20.5 * stage.rows * row_bytes
    assert stage.fits(device, memory, LEVELS, 1 if stage.grey else 3) == 20
    (row,) = rows(device, stage, POINTS, LEVELS, 3, limits_of(device), memory)
    assert (row["parts"], row["points_in_a_part"], row["measured"]) == (4, 18, 72) and row["correct"]
    assert "4 parts of 18 points" in row["note"]
    moved, done = (costs.visibility if stage.grey else costs.haar)(Size(72, LEVELS, 1 if stage.grey else 3))
    assert (row["bytes"], row["flops"]) == (moved, done)


def test_a_stage_is_one_function_and_may_overwrite_its_input(device: Device) -> None:
    state = {"value": 0, "resets": 0}

    def reset() -> None:
        state["value"], state["resets"] = 1, state["resets"] + 1

    def prepare(device: Device, points: int, levels: int, channels: int) -> Job:
        def call() -> int:
            assert state["value"] == 1
            state["value"] = 2
            return 2

        return Job(call, 1.0, 1.0, lambda result: abs(result - 2), reset=reset)

    (row,) = rows(device, Stage("own", "own", prepare), 5, LEVELS, 3, limits_of(device), 1e9)
    assert row["correct"] and state["resets"] == row["parts"] * 5 + 1 and row["clock"] == "wall"


# --- comparison ----------------------------------------------------------------------------------------------


def slowed(result: Row, factor: float) -> Row:
    """The same run, every stage `factor` times slower."""
    out = copy.deepcopy(result)
    for row in out["rows"]:
        row["points_per_second"] /= factor
        row["seconds"] = {key: value * factor for key, value in row["seconds"].items()}
        row["share_of_limit"] = row["share_of_limit"] and row["share_of_limit"] / factor
    return out


def steady(result: Row) -> Row:
    """The same run with runs of one length."""
    out = copy.deepcopy(result)
    for row in out["rows"]:
        row["seconds"] = dict.fromkeys(row["seconds"], row["seconds"]["median"])
    return out


def test_compare_passes_equals_and_marks_what_became_slower(result: Row) -> None:
    before = steady(result)
    same, unmatched = compare.compare(before, before)
    assert unmatched == 0 and not any(row["regression"] for row in same)
    after = copy.deepcopy(before)
    after["rows"][3] = slowed(before, 1.2)["rows"][3]
    found, _ = compare.compare(before, after)
    assert [row["regression"] for row in found] == [i == 3 for i in range(len(found))]
    assert found[3]["rate_ratio"] == pytest.approx(1 / 1.2)
    assert compare.text(found, 0).count("REGRESSION") == 1
    assert not any(row["regression"] for row in compare.compare(before, slowed(before, 1.05))[0])
    assert not any(row["regression"] for row in compare.compare(slowed(before, 1.2), before)[0])


def test_a_difference_within_the_spread_is_none(result: Row) -> None:
    before = steady(result)
    for row in before["rows"]:
        row["seconds"]["max"] *= 1.5
    assert not any(row["regression"] for row in compare.compare(before, slowed(steady(result), 1.3))[0])
    assert all(row["regression"] for row in compare.compare(before, slowed(steady(result), 1.6))[0])


def test_a_slower_machine_is_no_regression(result: Row) -> None:
    before = steady(result)
    after = slowed(before, 1.5)
    for row, was in zip(after["rows"], before["rows"], strict=True):
        row["share_of_limit"] = was["share_of_limit"]
    found = compare.compare(before, after)[0]
    assert {row["stage"] for row in found if row["regression"]} == {
        name for name, stage in STAGES.items() if stage.host
    }


def test_rows_of_other_sizes_are_counted(result: Row) -> None:
    other = copy.deepcopy(result)
    for row in other["rows"]:
        row["points"] += 1
    found, unmatched = compare.compare(result, other)
    assert (
        not found
        and unmatched == len(result["rows"])
        and "none of the same" in compare.text(found, unmatched)
    )


@pytest.mark.parametrize(("factor", "status"), [(1e-4, 1), (1e4, 0)])
def test_compare_on_the_command_line(
    run: Run, result: Row, tmp_path: Path, factor: float, status: int
) -> None:
    old = tmp_path / "old.json"
    old.write_text(json.dumps(slowed(result, factor)), encoding="utf-8")
    ran = run(*TINY, "--stages", "forward_haar", "--compare", old)
    assert ran.status == status and ("REGRESSION" in ran.out) == bool(status) and "points/s x" in ran.out


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (None, "cannot be read"),
        ("no JSON", "got no JSON"),
        ("[1, 2]", "got other JSON"),
        ('{"rows": []}', "got other JSON"),
        (json.dumps({"format": compare.FORMAT, "rows": 3}), "expected rows"),
        (json.dumps({"format": compare.FORMAT, "rows": [{"stage": "light"}]}), "numbers missing"),
    ],
)
def test_bad_files_to_compare_with(run: Run, tmp_path: Path, content: str | None, word: str) -> None:
    old = tmp_path / "old.json"
    if content is not None:
        old.write_text(content, encoding="utf-8")
    ran = run(*TINY, "--compare", old)
    assert ran.status == 2 and ran.out == "" and word in ran.err and str(old) in ran.err
    assert len(ran.err.splitlines()) <= 2


# --- plots and bad options -----------------------------------------------------------------------------------


def test_plots_are_written(result: Row, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    assert [path.name for path in plots.write(result, tmp_path)] == ["roofline.png", "roofline.svg"]
    more = copy.deepcopy(result)
    for row in more["rows"]:
        row["points"] *= 10
    both = {**result, "rows": result["rows"] + more["rows"]}
    names = {path.name for path in plots.write(both, tmp_path)}
    assert names == {"roofline.png", "roofline.svg", "scaling.png", "scaling.svg"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert all(path.stat().st_size > 1000 for path in tmp_path.iterdir())
    assert (tmp_path / "roofline.png").read_bytes().startswith(b"\x89PNG")


def test_plots_without_matplotlib(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ran = run(*TINY, "-o", tmp_path / "out")
    assert ran.status == 2 and "pip install 'prtcl[plots]'" in ran.err and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--stages", "light", "nonsense"), "nonsense is none"),
        (("--points", "0"), "whole number, 1 or more"),
        (("--levels", "12"), "whole number, 2 to 9"),
        (("--levels", "x"), "whole number"),
        (("--runs", "4"), "5 or more"),
        (("--channels", "2"), "invalid choice"),
        (("--memory", "-1"), "GiB of memory"),
        (("--memory", "nan"), "GiB of memory"),
    ],
)
def test_bad_options(run: Run, arguments: tuple[str, ...], word: str) -> None:
    ran = run(*arguments)
    assert ran.status == 2 and ran.out == "" and word in ran.err and len(ran.err.splitlines()) <= 2


def test_a_folder_that_cannot_be_made(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ran = run(*TINY, "--no-plots", "-o", tmp_path / "file")
    assert ran.status == 2 and "cannot make the folder" in ran.err


def test_stages_come_in_the_table_s_order() -> None:
    assert command._names(None)[0] == "visibility" and set(command._names(None)) == set(STAGES)
    assert command._names(["inverse_haar", "visibility"]) == ["visibility", "inverse_haar"]
    with pytest.raises(InputError, match=r"there are: visibility"):
        command._names(["none"])


# --- rivals --------------------------------------------------------------------------------------------------


def rivals_of(device: Device, stage: str, monkeypatch: pytest.MonkeyPatch, *names: str) -> list[Row]:
    """Rows of the named rivals beside a stage: some of the others take a minute to compile."""
    monkeypatch.setitem(RIVALS, stage, [each for each in RIVALS[stage] if each[0] in names])
    ours, *others = rows(device, STAGES[stage], POINTS, LEVELS, 3, limits_of(device), 1e9, rivals=True)
    assert ours["correct"] and [row["rival"] for row in others] == list(names)
    return others


@pytest.mark.parametrize("stage", ["forward_haar", "inverse_haar"])
def test_pywavelets_gives_what_we_give(device: Device, monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    pytest.importorskip("pywt", reason="PyWavelets is not installed")
    (row,) = rivals_of(device, stage, monkeypatch, "PyWavelets")
    assert row["skipped"] is None and row["correct"] and row["error"] < 1e-6
    assert row["times_faster"] > 0 and row["points_per_second"] > 0 and "thread" in row["way"]


@pytest.mark.parametrize(
    ("stage", "name"),
    [
        ("product", "NumPy"),
        ("dense_reduction", "NumPy"),
        ("inner_product", "NumPy"),
        ("visibility", "embree, bare"),
    ],
)
def test_rivals_that_are_always_there(
    device: Device, monkeypatch: pytest.MonkeyPatch, stage: str, name: str
) -> None:
    (row,) = rivals_of(device, stage, monkeypatch, name)
    assert row["skipped"] is None and row["correct"] and row["times_faster"] > 0


def test_numba_gives_what_we_give(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba", reason="Numba is not installed")
    for stage in ("product", "inner_product"):
        (row,) = rivals_of(device, stage, monkeypatch, "Numba")
        assert row["skipped"] is None and row["correct"] and "fastmath" in row["way"]


def test_pytorch_gives_what_we_give(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Uncompiled, as on a machine without a compiler: that takes seconds."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")

    def refuse(*_: Any, **__: Any) -> None:
        raise RuntimeError("no compiler")

    monkeypatch.setattr(torch, "compile", refuse)
    for stage in ("forward_haar", "inverse_haar", "product", "inner_product"):
        (row,) = rivals_of(device, stage, monkeypatch, "PyTorch")
        assert row["skipped"] is None and row["correct"] and "eager (RuntimeError" in row["way"]


def test_a_rival_that_fails_ends_nothing(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise ZeroDivisionError("oh\nno")

    monkeypatch.setitem(RIVALS, "product", [("NumPy", fail)])
    (row,) = rivals_of(device, "product", monkeypatch, "NumPy")
    assert row["skipped"] == "failed: ZeroDivisionError: oh"


def test_missing_rivals_say_so(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("pywt", "torch"):
        monkeypatch.setitem(sys.modules, module, None)
    for row in rivals_of(device, "forward_haar", monkeypatch, "PyWavelets", "PyTorch"):
        assert "pip install 'prtcl[bench]'" in row["skipped"]
        assert row["rival"] in table.rival(row) and "skipped" in table.rival(row)


def test_a_wrong_rival_is_compared_with_nothing(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = world.host_rows
    monkeypatch.setattr(world, "host_rows", lambda *a: honest(*a) * np.float32(1.1))
    (row,) = rivals_of(device, "product", monkeypatch, "NumPy")
    assert not row["correct"] and row["times_faster"] is None and "WRONG" in table.rival(row)[-1]


def test_every_rival_rivals_a_stage() -> None:
    assert set(RIVALS) <= set(STAGES)


def test_the_tuner_tries_every_form_and_keeps_one(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(tuning.VARIABLE, str(tmp_path / "tuning.json"))
    monkeypatch.setattr(tune, "LEVELS", (LEVELS,))
    monkeypatch.setattr(tune, "TIMED_BY", {"haar": ("forward_haar",), "sparse": ("sparse_reduction",)})
    found = tune.tune(device, POINTS, 5, 2**28)
    for name, (form, ratios) in found.items():
        assert form in tuning.KNOWN[name].forms and len(ratios) == len(tuning.KNOWN[name].forms)
        assert min(ratios.values()) == ratios[f"{form.name} {form.size}"] == 1.0
    assert set(tune.TIMED_BY) <= set(tuning.KNOWN)
    tuning.save(device, {name: form for name, (form, _) in found.items()})
    assert tuning.KNOWN["haar"].of(device) == found["haar"][0]
    tuning._entries.cache_clear()


def test_every_tunable_of_the_library_is_timed() -> None:
    assert set(tune.TIMED_BY) == set(tuning.KNOWN)
    assert {stage for stages in tune.TIMED_BY.values() for stage in stages} <= set(STAGES)


@pytest.mark.parametrize("told", [0.0, 1e-9, 0.25])
def test_a_device_whose_events_tell_no_time_is_timed_by_the_wall(told: float) -> None:
    timing = measure.Timing((told, 0.5), (1.0, 2.0))
    assert timing.kernels == ((0.25, 0.5) if told == 0.25 else (1.0, 2.0))
