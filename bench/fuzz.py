"""Damaged files to every reader: each must give a value or an InputError, in time, and without a crash.

    python bench/fuzz.py [--inputs 110000] [--seed 1] [-o bench/results/fuzz.json]
    python bench/fuzz.py --inputs 30000 --part 2/4 -o part2.json     (the second quarter of each reader's inputs)
    python bench/fuzz.py --merge part*.json -o bench/results/fuzz.json
    python bench/fuzz.py --again exr 1234                            (one input again, with its traceback)

The inputs are mutations (bench/mutations.py) of small valid files (bench/fuzz_readers.py); number i of a reader depends
on the seed, the reader and i alone. They are read in worker processes of bounded memory: what kills one, or keeps it
busy for more than --limit seconds, is a finding, and so is every exception but InputError and every answer that breaks
the reader's promise (NaN, indices out of range). The exit status is 1 if there is any.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import scenes
from fuzz_readers import READERS

from prtcl.errors import InputError

MEMORY = 6 << 30
"""Bytes of address space of a worker. Files here are of kilobytes: one that asks for more is not held to its size."""
BATCH = 5000
"""Inputs of one worker process; its imports take a second."""


def rng_of(seed: int, name: str, number: int) -> np.random.Generator:
    return np.random.default_rng((seed, list(READERS).index(name), number))


def work(
    name: str, seed: int, first: int, stop: int, folder: Path, progress: Path | None = None
) -> dict[str, Any]:
    """Read inputs first … stop − 1 of a reader, one after the other, in this process.

    Returns
    -------
    counts : how many gave a value, were refused, warned
    findings : a dict for each that did something else, with its number and traceback
    warning : the first, if any: they are counted, and are no findings
    """
    reader, counts, findings, first_warning = READERS[name], Counter[str](), [], ""
    folder.mkdir(parents=True, exist_ok=True)
    bases = reader.make(folder)
    for base in bases if reader.valid else ():
        reader.read(base)
    for number in range(first, stop):
        if progress is not None:
            progress.write_text(str(number))
        path = reader.spoil(folder, bases, rng_of(seed, name, number))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                reader.read(path)
                counts["value"] += 1
            except InputError as error:
                counts["refused"] += 1
                if len(str(error).splitlines()) > 2 or str(path.name) not in str(error):
                    findings.append(
                        {"reader": name, "number": number, "kind": "message", "what": str(error)[:400]}
                    )
            except Exception as error:
                kind = "answer" if isinstance(error, AssertionError) else "exception"
                what = "".join(traceback.format_exception(error)[-3:])
                findings.append({"reader": name, "number": number, "kind": kind, "what": what})
        if told:
            counts["warned"] += 1
            first_warning = first_warning or f"{number}: {told[0].category.__name__}: {told[0].message}"
    return {"counts": counts, "findings": findings, "warning": first_warning}


def supervise(
    name: str, seed: int, first: int, stop: int, limit: float, command: list[str] | None = None
) -> dict[str, Any]:
    """`work` in a process of its own, begun again after what killed it or took too long.

    Parameters
    ----------
    limit : seconds for one input
    command : of the worker; for the test of this function
    """
    counts, findings = Counter[str](), []
    worker = command or [sys.executable, str(Path(__file__).resolve()), "--worker", name, str(seed)]
    while first < stop:
        last = min(first + BATCH, stop)
        with tempfile.TemporaryDirectory() as folder:
            progress, out = Path(folder, "progress"), Path(folder, "out.json")
            arguments = [str(first), str(last), folder, str(progress), str(out)]
            # Libraries tell standard error of each damage they find.
            told = Path(folder, "stderr")
            with (
                told.open("wb") as errors,
                subprocess.Popen([*worker, *arguments], stdout=subprocess.DEVNULL, stderr=errors) as process,
            ):
                hung = _watch(process, progress, limit)
            last_words = told.read_text(errors="replace")[-600:]
            if process.returncode == 0:
                found = json.loads(out.read_text())
                counts += Counter(found["counts"])
                findings += found["findings"]
                if found["warning"]:
                    print(f"{name} warned, first of {found['warning']}", file=sys.stderr)
                first = last
                continue
            if not progress.exists():
                raise SystemExit(
                    f"{name}: the worker failed before its first input, status {process.returncode}"
                )
            number = int(progress.read_text())
        kind, what = (
            ("hang", f"more than {limit:g} s")
            if hung
            else ("crash", f"status {process.returncode}: {last_words}")
        )
        findings.append({"reader": name, "number": number, "kind": kind, "what": what})
        if number > first:  # what came before it is read once more, for its counts
            before = supervise(name, seed, first, number, limit, command)
            counts += before["counts"]
            findings += before["findings"]
        first = number + 1
    return {"counts": counts, "findings": findings}


def _watch(process: subprocess.Popen[bytes], progress: Path, limit: float) -> bool:
    """Wait for the worker; kill it, and return True, where its input's number stays the same for too long."""
    seen, since = "", time.monotonic()
    while True:
        try:
            process.wait(0.2)
            return False
        except subprocess.TimeoutExpired:
            number = progress.read_text() if progress.exists() else ""
            if number != seen:
                seen, since = number, time.monotonic()
            # The first input waits for imports and for the valid files.
            if time.monotonic() - since > limit + (60.0 if not seen else 0.0):
                process.kill()
                process.wait()
                return True
        except BaseException:
            process.kill()
            raise


def worker(name: str, seed: str, first: str, stop: str, folder: str, progress: str, out: str) -> None:
    """The process that `supervise` starts."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    found = work(name, int(seed), int(first), int(stop), Path(folder, "files"), Path(progress))
    Path(out).write_text(json.dumps(found))


def inputs_of(name: str, inputs: int) -> int:
    """How many of all inputs a reader gets."""
    return max(1, round(inputs * READERS[name].share / sum(reader.share for reader in READERS.values())))


def merge(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """The parts of one run as one result."""
    readers: dict[str, Counter[str]] = {}
    for part in parts:
        for name, counts in part["readers"].items():
            readers[name] = readers.get(name, Counter()) + Counter(counts)
    return {
        "inputs": sum(part["inputs"] for part in parts),
        "seconds": round(sum(part["seconds"] for part in parts), 1),
        "seed": parts[0]["seed"],
        "readers": readers,
        "findings": [finding for part in parts for finding in part["findings"]],
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--inputs", type=int, default=110_000, help="of all readers together (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--limit", type=float, default=10.0, help="seconds for one input (default: %(default)s)"
    )
    parser.add_argument("--readers", nargs="+", choices=list(READERS), default=list(READERS))
    parser.add_argument(
        "--part", default="1/1", metavar="K/N", help="the K-th of N parts of each reader's inputs"
    )
    parser.add_argument("--merge", nargs="+", type=Path, metavar="PART.json")
    parser.add_argument("--again", nargs=2, metavar=("READER", "NUMBER"))
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    if options.again:
        with tempfile.TemporaryDirectory() as folder:
            name, number = options.again[0], int(options.again[1])
            bases = READERS[name].make(Path(folder))
            READERS[name].read(READERS[name].spoil(Path(folder), bases, rng_of(options.seed, name, number)))
        return 0
    if options.merge:
        result = merge([json.loads(part.read_text()) for part in options.merge])
    else:
        part, parts = (int(number) for number in options.part.split("/"))
        start, readers, findings, total = time.perf_counter(), {}, [], 0
        for name in options.readers:
            count = inputs_of(name, options.inputs)
            first, stop = count * (part - 1) // parts, count * part // parts
            found = supervise(name, options.seed, first, stop, options.limit)
            readers[name] = {"inputs": stop - first, **found["counts"]}
            findings += found["findings"]
            total += stop - first
            print(f"{name}: {readers[name]}, {len(found['findings'])} findings", file=sys.stderr, flush=True)
        seconds = round(time.perf_counter() - start, 1)
        result = {
            "inputs": total,
            "seconds": seconds,
            "seed": options.seed,
            "readers": readers,
            "findings": findings,
        }
    scenes.save(options.output, command="python bench/fuzz.py", **result)
    print(f"{result['inputs']} inputs, {len(result['findings'])} findings, {result['seconds']} s")
    for finding in result["findings"][:20]:
        print(f"{finding['reader']} {finding['number']}: {finding['kind']}: {finding['what']}")
    return 1 if result["findings"] else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        sys.exit(main())
