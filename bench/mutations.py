"""Seeded mutations of bytes for bench/fuzz.py: flips, random and extreme values, fields of length, cuts, splices."""

from __future__ import annotations

import numpy as np

EXTREMES = (
    0,
    1,
    2,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0x8000,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    1 << 62,
    (1 << 64) - 1,
)
"""What length fields are set to: nothing, little, and the ends of every signed and unsigned size."""
SPECIALS = np.array([np.nan, np.inf, -np.inf, -1.0, 1e38, -0.0, 1e-45, 1e308])
DIGITS = b"0123456789-+.eE \n"


def mutate(data: bytes, rng: np.random.Generator, head: int, other: bytes) -> bytes:
    """One to three mutations in a row, half of them within the first `head` bytes, where lengths and types lie.

    Parameters
    ----------
    other : what splices take bytes from: another valid file of the same kind, or the same one
    """
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        if not out:
            break
        end = min(head, len(out)) if rng.random() < 0.5 else len(out)
        KINDS[int(rng.integers(len(KINDS)))](out, int(rng.integers(end)), rng, other)
    return bytes(out)


def flip(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """One bit."""
    out[at] ^= 1 << int(rng.integers(8))


def noise(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """Some random bytes in a row."""
    for place in range(at, min(at + int(rng.integers(1, 17)), len(out))):
        out[place] = int(rng.integers(256))


def length(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """A field of 1, 2, 4 or 8 bytes, in either order, at an extreme; mostly where fields are aligned."""
    size = 1 << int(rng.integers(4))
    at -= at % size if rng.random() < 0.5 else 0
    value = EXTREMES[int(rng.integers(len(EXTREMES)))] % (1 << 8 * size)
    field = value.to_bytes(size, "little" if rng.random() < 0.7 else "big")
    out[at : at + size] = field[: len(out) - at]


def special(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """A number that is no usual one, as float32 or float64."""
    field = SPECIALS[int(rng.integers(len(SPECIALS)))]
    with np.errstate(over="ignore"):
        written = (np.float32(field) if rng.random() < 0.5 else field).tobytes()
    out[at : at + len(written)] = written[: len(out) - at]


def digits(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """Text of a number, over what was there: for JSON and the headers of .hdr and .npy."""
    places = [place for place in range(at, min(at + 64, len(out))) if out[place : place + 1].isdigit()]
    start = places[0] if places else at
    for place in range(start, min(start + int(rng.integers(1, 12)), len(out))):
        out[place] = DIGITS[int(rng.integers(len(DIGITS)))]


def cut(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """The file's end is missing."""
    del out[at:]


def grow(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """Bytes after the end."""
    out += rng.bytes(int(rng.integers(1, 65)))


def remove(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """A run is missing in the middle."""
    del out[at : at + int(rng.integers(1, 33))]


def repeat(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """A run comes twice."""
    out[at:at] = out[at : at + int(rng.integers(1, 65))]


def splice(out: bytearray, at: int, rng: np.random.Generator, other: bytes) -> None:
    """A run of another file, over what was there; now and then all from there on."""
    start = int(rng.integers(len(other)))
    if rng.random() < 0.2:
        out[at:] = other[start:]
    else:
        run = other[start : start + int(rng.integers(1, 65))]
        out[at : at + len(run)] = run


KINDS = (flip, noise, length, length, special, digits, cut, grow, remove, repeat, splice)
