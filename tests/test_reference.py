"""The float64 oracle against what shares no code with it: definitions, PyWavelets, closed forms, laws."""

from __future__ import annotations

import numpy as np
import pytest
import pywt
import tolerances
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import quadtree, reference

U = tolerances.UNIT["float64"]
SEEDS = st.integers(0, 2**31)


def random_rows(seed: int, rows: int, levels: int) -> NDArray[np.float64]:
    """Gaussian rows of 4**levels, each at its own scale from 1e-3 to 1e3."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, 4**levels)) * 10 ** rng.uniform(-3, 3, (rows, 1))


def unit_vectors(rng: np.random.Generator, count: int, lowest: float = 1e-3) -> NDArray[np.float64]:
    """Directions of the upper hemisphere, uniform in z from `lowest` to 1."""
    z, phi = rng.uniform(lowest, 1, count), rng.uniform(0, 2 * np.pi, count)
    s = np.sqrt(1 - z**2)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


# --- Haar --------------------------------------------------------------------------------------------------


def wavelet_on_grid(levels: int, level: int, square: tuple[int, int], wavelet: int) -> NDArray[np.float64]:
    """One basis function from its definition, on the picture (rows, columns): ±2^(r−R) on its square."""
    side = 2**levels
    run = side >> level
    rows, columns = np.mgrid[0:side, 0:side]
    inside = (rows // run == square[0]) & (columns // run == square[1])
    column_bit, row_bit = (columns % run) >= run // 2, (rows % run) >= run // 2
    flip = (column_bit & bool(wavelet & 1)) ^ (row_bit & bool(wavelet & 2))
    return np.where(inside, np.where(flip, -1.0, 1.0), 0.0) * 2.0 ** (level - levels)


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_basis_is_the_definition(levels: int) -> None:
    picture = reference.basis(levels)[:, quadtree.grid_to_morton(levels)]
    assert (picture[0] == 2.0**-levels).all()
    for level in range(levels):
        rows, columns = quadtree.morton_to_grid(level)
        for s in range(4**level):
            for m in (1, 2, 3):
                expected = wavelet_on_grid(levels, level, (rows[s], columns[s]), m)
                assert (picture[quadtree.coefficient(level, s, m)] == expected).all()


@pytest.mark.parametrize("levels", [0, 1, 2, 3, 4])
def test_basis_is_orthonormal(levels: int) -> None:
    functions = reference.basis(levels)
    # Powers of two: every product and sum is exact.
    assert (functions @ functions.T == np.eye(4**levels)).all()
    assert (reference.haar(np.eye(4**levels)) == functions.T).all()


@pytest.mark.parametrize("levels", range(1, 8))
@given(seed=SEEDS, rows=st.integers(1, 4))
def test_round_trip_and_parseval(levels: int, seed: int, rows: int) -> None:
    x = random_rows(seed, rows, levels)
    c = reference.haar(x)
    bound = tolerances.haar(levels, U, x)
    assert_close(tolerances.norms(reference.ihaar(c) - x), np.zeros((rows, 1)), 2 * bound, zeros=1)
    assert_close(
        tolerances.norms(reference.haar(reference.ihaar(x)) - x), np.zeros((rows, 1)), 2 * bound, zeros=1
    )
    # ‖c‖ differs from ‖x‖ by at most ‖error‖, and norms of 4^levels terms by levels u (pairwise sums).
    assert_close(tolerances.norms(c), tolerances.norms(x), bound + 4 * levels * U * tolerances.norms(x))


def test_round_trip_of_integers_is_exact() -> None:
    x = np.random.default_rng(3).integers(-1000, 1000, (5, 4**5)).astype(np.float64)
    assert (reference.ihaar(reference.haar(x)) == x).all()


@pytest.mark.parametrize("levels", range(1, 8))
@given(seed=SEEDS)
def test_agrees_with_pywavelets(levels: int, seed: int) -> None:
    x = random_rows(seed, 1, levels)[0]
    approximation, *details = pywt.wavedec2(x[quadtree.grid_to_morton(levels)], "haar", level=levels)
    expected = np.empty(4**levels)
    expected[0] = approximation[0, 0]
    for level, (rows_change, columns_change, both) in enumerate(details):
        rows, columns = quadtree.morton_to_grid(level)
        for m, plane in ((1, columns_change), (2, rows_change), (3, both)):  # pywt's H runs along axis 0
            expected[4**level + m - 1 : 4 ** (level + 1) : 3] = plane[rows, columns]
    got = reference.haar(x)
    # pywt multiplies by 1/sqrt 2, rounded, twice a level: 4 u more a level than ours.
    bound = 3 * tolerances.haar(levels, U, x)
    assert_close(tolerances.norms(got - expected), [0.0], bound, zeros=1)


def test_picture_of_one_column_edge() -> None:
    # Left half 1, right half 0: only the mean and wavelet 01 of the whole see it.
    columns = quadtree.morton_to_grid(3)[1]
    c = reference.haar((columns < 4).astype(np.float64))
    assert c[0] == c[1] == 4.0
    assert not c[2:].any()


# --- triple products ----------------------------------------------------------------------------------------


def ancestor(function: tuple[int, int, int], level: int) -> int:
    """Index of the square of a coarser level that holds a function's (level, square, wavelet)."""
    return function[1] >> (2 * (function[0] - level))


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_tripling_coefficients_are_the_four_cases(levels: int) -> None:
    c = reference.tripling_coefficients(levels)
    kinds = [(-1, 0, 0)] + [(r, s, m) for r in range(levels) for s in range(4**r) for m in (1, 2, 3)]
    signs = quadtree.SIGNS.astype(np.float64)
    for i, first in enumerate(kinds):
        for j, second in enumerate(kinds[: i + 1]):
            for k, third in enumerate(kinds[: j + 1]):
                coarse, middle, fine = sorted((first, second, third))
                expected = 0.0
                if fine[0] == -1:
                    expected = 2.0**-levels
                elif len({first, second, third}) == 3 and coarse[:2] == fine[:2]:
                    expected = 2.0 ** (fine[0] - levels)
                elif middle == fine and coarse[0] == -1:
                    expected = 2.0**-levels
                elif middle == fine and coarse[0] < fine[0] and ancestor(fine, coarse[0]) == coarse[1]:
                    child = ancestor(fine, coarse[0] + 1) & 3
                    expected = signs[coarse[2] - 1, child] * 2.0 ** (coarse[0] - levels)
                assert abs(c[i, j, k] - expected) <= 4**levels * U, (first, second, third)


@pytest.mark.parametrize("levels", [0, 1, 2, 3])
def test_triple_brute_force_oracle_and_tree_agree(levels: int) -> None:
    a, b = random_rows(levels, 2, levels)
    brute = np.einsum("ijk,j,k->i", reference.tripling_coefficients(levels), a, b)
    oracle, tree = reference.triple(a, b), reference.triple_tree(a, b)
    # Three transforms and a product: 2 levels u each of ‖a b‖ ≤ ‖a‖ ‖b‖ (the largest sample is below the
    # norm).
    scale = np.linalg.norm(a) * np.linalg.norm(b)
    assert_close(oracle, brute, (6 * levels + 1 + 3 * 4**levels) * U * scale)
    assert_close(tree, oracle, (6 * levels + 1) * U * scale + tolerances.triple(a, b, "float64"))


@pytest.mark.parametrize("levels", [4, 5])
def test_tree_form_agrees_with_the_oracle(levels: int) -> None:
    a, b = random_rows(levels, 2, levels)
    scale = np.linalg.norm(a) * np.linalg.norm(b)
    bound = (6 * levels + 1) * U * scale + tolerances.triple(a, b, "float64")
    assert_close(reference.triple_tree(a, b), reference.triple(a, b), bound)


@pytest.mark.parametrize("levels", [2, 3])
def test_the_printed_formula_is_wrong(levels: int) -> None:
    """The supplemental's 2^(r−r') in G_j errs by order 1; 2^(r−R) agrees to rounding."""
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(2, 4**levels))
    brute = np.einsum("ijk,j,k->i", reference.tripling_coefficients(levels), a, b)
    printed = np.abs(reference.triple_tree(a, b, as_printed=True) - brute).max()
    assert printed > 0.3, f"the printed form errs by {printed}"
    assert_close(
        reference.triple_tree(a, b), brute,
        tolerances.triple(a, b, "float64") + 3 * 4**levels * U * np.linalg.norm(a) * np.linalg.norm(b),
    )  # fmt: skip


@given(seed=SEEDS, levels=st.integers(1, 5))
def test_triple_is_symmetric_and_bilinear(seed: int, levels: int) -> None:
    a, b, c = random_rows(seed, 3, levels)
    assert (reference.triple(a, b) == reference.triple(b, a)).all()
    scale = np.linalg.norm(a) * (np.linalg.norm(b) + np.linalg.norm(c))
    left = reference.triple(a, b + 2 * c)
    assert_close(left, reference.triple(a, b) + 2 * reference.triple(a, c), 4 * (6 * levels + 2) * U * scale)
    # The full triple integral does not care which factor is collapsed last.
    integral = [reference.triple(a, b) @ c, reference.triple(a, c) @ b, reference.triple(b, c) @ a]
    bound = (6 * levels + 1 + 4**levels) * U * np.prod([np.linalg.norm(x) for x in (a, b, c)])
    assert_close(integral[1:], [integral[0]] * 2, 2 * bound)


@given(seed=SEEDS, levels=st.integers(1, 6))
def test_all_ones_factor_is_the_identity(seed: int, levels: int) -> None:
    a = random_rows(seed, 1, levels)[0]
    ones = reference.haar(np.ones(4**levels))
    assert ones[0] == 2**levels
    assert not ones[1:].any()
    bound = 2 * tolerances.haar(levels, U, a)
    assert_close(tolerances.norms(reference.triple(a, ones) - a), [0.0], bound, zeros=1)


@pytest.mark.parametrize("levels", [1, 3, 5])
def test_parent_sums_are_the_signed_sums_of_coarser_coefficients(levels: int) -> None:
    a = random_rows(9, 1, levels)[0]
    expected = []
    for r in range(levels):
        for s in range(4**r):
            total = 2.0**-levels * a[0]
            for coarser in range(r):
                parent, child = s >> (2 * (r - coarser)), (s >> (2 * (r - coarser - 1))) & 3
                for m in (1, 2, 3):
                    sign = float(quadtree.SIGNS[m - 1, child])
                    total += sign * 2.0 ** (coarser - levels) * a[quadtree.coefficient(coarser, parent, m)]
            expected.append(total)
    bound = 2 * tolerances.haar(levels, U, a)[0] + (3 * levels + 1) * U * np.abs(a).sum()
    assert_close(reference.parent_sums(a), expected, bound)


# --- directions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", range(0, 8))
def test_directions_are_unit_and_above_the_horizon(levels: int) -> None:
    d = reference.directions(levels)
    assert_close(np.linalg.norm(d, axis=1), np.ones(4**levels), 8 * U)
    assert (d[:, 2] > 0).all()
    assert len(np.unique(d.round(12), axis=0)) == 4**levels


def test_cells_have_equal_areas() -> None:
    """The area of a cell is the integral of |∂d/∂u × ∂d/∂v|: 2π everywhere, by central differences."""
    rng = np.random.default_rng(4)
    u, v = rng.uniform(0.01, 0.99, (2, 4000))
    smooth = np.abs(np.abs(u - 0.5) - np.abs(v - 0.5)) > 1e-3  # the map has kinks on the diagonals
    u, v, h = u[smooth], v[smooth], 1e-5
    du = (reference.square_to_hemisphere(u + h, v) - reference.square_to_hemisphere(u - h, v)) / (2 * h)
    dv = (reference.square_to_hemisphere(u, v + h) - reference.square_to_hemisphere(u, v - h)) / (2 * h)
    area = np.linalg.norm(np.cross(du, dv), axis=1)
    # Rounding of the difference u/h; its third derivatives grow like 1/r³ towards the centre and the rim.
    assert_close(area, np.full(area.shape, 2 * np.pi), 1e-4)


@pytest.mark.parametrize("levels", [4, 6])
def test_moments_of_the_hemisphere(levels: int) -> None:
    d = reference.directions(levels)
    area = 2 * np.pi / 4**levels
    # z is uniform over equal areas: ∫ z = π, ∫ z² = 2π/3. With max(|a|, |b|) = (2k + 1)/side in 4 (2k + 1)
    # cells the midpoint rule's mean of z is 1/2 + 1/4**levels exactly.
    assert_close(d[:, 2].sum() * area, np.pi * (1 + 2 / 4**levels), 64 * U)
    assert_close((d[:, 2] ** 2).sum() * area, 2 * np.pi / 3, 4 * np.pi / 4**levels)
    assert_close(d[:, :2].sum(axis=0) + 1, [1.0, 1.0], 4**levels * U)


@given(seed=SEEDS)
def test_square_and_hemisphere_are_inverse(seed: int) -> None:
    u, v = np.random.default_rng(seed).uniform(0, 1, (2, 100))
    d = reference.square_to_hemisphere(u, v)
    assert_close(
        np.stack(reference.hemisphere_to_square(d)), np.stack([u, v]), 1e-7
    )  # √ of 1 − z near the pole


def test_disk_by_hand() -> None:
    d = reference.square_to_hemisphere([0.5, 1.0, 0.5, 0.0, 1.0], [0.5, 0.5, 1.0, 0.5, 1.0])
    half = np.sqrt(0.5)
    expected = [[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [half, half, 0]]
    assert_close(d, expected, 4 * U, zeros=0.7)


def test_equirectangular_by_hand() -> None:
    # −z is the left edge u = 0, +x a quarter, +z a half, −x three quarters; +y the top, −y the bottom.
    u, v = reference.equirectangular([[0, 0, -1], [1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    assert u[:4].tolist() == [0, 0.25, 0.5, 0.75]
    assert v.tolist() == [0.5, 0.5, 0.5, 0.5, 0, 1]


def test_environment_at_texel_centres_is_the_texel() -> None:
    image = np.random.default_rng(2).uniform(0, 5, (8, 16, 3))
    v, u = np.meshgrid((np.arange(8) + 0.5) / 8, (np.arange(16) + 0.5) / 16, indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    world = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    assert_close(reference.environment(image, world), image, 256 * U * 5)


def test_environment_wraps_columns_and_clamps_rows() -> None:
    image = np.zeros((2, 4, 3))
    image[:, 0], image[:, 3] = 1.0, 3.0
    assert_close(
        reference.environment(image, [0.0, 0.0, -1.0]), np.full(3, 2.0), 8 * U
    )  # between the last and first
    image = np.zeros((2, 4, 3))
    image[0], image[1] = 5.0, 7.0
    assert_close(
        reference.environment(image, [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]), [[5.0] * 3, [7.0] * 3], 0.0
    )


# --- reflectance --------------------------------------------------------------------------------------------

GOLD = {"kind": "ggx", "alpha": 0.3, "eta": np.array([0.18, 0.42, 1.37]), "k": np.array([3.42, 2.35, 1.77])}
PLASTIC = {"kind": "ggx", "alpha": 0.2, "f0": 0.04, "kd": np.array([0.5, 0.3, 0.1])}
BLINN = {"kind": "blinn", "exponent": 50.0, "ks": 0.6, "kd": 0.3}
TABLE = {
    "kind": "table",
    "values": np.random.default_rng(6).uniform(0.1, 1, (5, 4, 3)),
    "theta_h": np.linspace(0, np.pi / 2, 5),
    "theta_d": np.array([0.0, 0.3, 0.9, 1.5]),
}
MATERIALS = [{"kind": "lambert", "albedo": 0.7}, GOLD, PLASTIC, BLINN, TABLE]


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: m["kind"])
def test_reciprocity_and_isotropy(material: dict[str, object]) -> None:
    rng = np.random.default_rng(7)
    i, o = unit_vectors(rng, 500), unit_vectors(rng, 500)
    forth = reference.brdf(material, i, o)
    assert (forth > 0).all()
    # arccos of a cosine near 1 turns u into √(2 u) of the angle; only the table takes one.
    slack = 2e-7 if material["kind"] == "table" else 1e-12
    assert_close(reference.brdf(material, o, i), forth, slack * forth.max())
    turn = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1.0]])
    assert_close(reference.brdf(material, i @ turn, o @ turn), forth, slack * forth.max())
    mirror = np.array([1.0, -1.0, 1.0])
    assert_close(reference.brdf(material, i * mirror, o * mirror), forth, slack * forth.max())


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: m["kind"])
def test_nothing_below_the_horizon(material: dict[str, object]) -> None:
    up, down = np.array([0.6, 0.0, 0.8]), np.array([0.6, 0.0, -0.8])
    for i, o in ((up, down), (down, up), (down, down), (np.array([1.0, 0, 0]), up)):
        assert not reference.brdf(material, i, o).any()


def albedo(material: dict[str, object], cosine: float, levels: int = 8) -> NDArray[np.float64]:
    d = reference.directions(levels)
    view = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    return (reference.brdf(material, d, view) * d[:, 2:3]).mean(axis=0) * 2 * np.pi


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.6, 1.0])
def test_white_furnace_of_ggx_loses_energy_never_gains(alpha: float) -> None:
    """With F = 1 single scattering reflects at most all: 1 − (what the masking loses)."""
    white = {"kind": "ggx", "alpha": alpha, "f0": 1.0}
    values = np.array([albedo(white, c)[0] for c in (1.0, 0.9, 0.6, 0.3, 0.1)])
    assert (values <= 1).all()
    assert (values >= 0.3).all()
    if alpha == 0.1:
        assert_close(values[0], 1.0, 0.02)  # nearly no masking at normal incidence


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_distribution_is_normalised(alpha: float) -> None:
    """∫ D(h) (n·h) dω = 1, by Gauss-Legendre in t = tan²θ/(α² + tan²θ), in which the integrand is smooth."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    t = (nodes + 1) / 2
    tan2 = alpha**2 * t / (1 - t)
    cosine = 1 / np.sqrt(1 + tan2)
    # dω cosθ = 2π sinθ cosθ dθ = π cos⁴θ d(tan²θ), and d(tan²θ)/dt = α²/(1 − t)²
    integrand = reference.ggx_distribution(cosine, alpha) * np.pi * cosine**4 * alpha**2 / (1 - t) ** 2
    assert_close((integrand * weights / 2).sum(), 1.0, 1e-9)


def test_masking_ends() -> None:
    assert reference.smith_g1(np.array([1.0]), 0.5)[0] == 1.0
    grazing = reference.smith_g1(np.array([1e-6]), 0.5)
    assert_close(grazing, [2 * 1e-6 / 0.5], 1e-11)  # G1 → 2 cosθ/α
    values = reference.smith_g1(np.linspace(0.01, 1, 100), 0.3)
    assert (np.diff(values) > 0).all()


@given(eta=st.floats(0.05, 10), k=st.floats(0, 10))
def test_conductor_at_normal_incidence(eta: float, k: float) -> None:
    expected = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    assert_close(reference.fresnel_conductor(np.array([1.0]), eta, k), [expected], 32 * U, zeros=1)


@given(eta=st.floats(1.01, 4), cosine=st.floats(0.01, 1))
def test_conductor_without_absorption_is_a_dielectric(eta: float, cosine: float) -> None:
    """Against Fresnel's sine and tangent laws' amplitude form, in real arithmetic."""
    inside = np.sqrt(1 - (1 - cosine**2) / eta**2)
    s = (cosine - eta * inside) / (cosine + eta * inside)
    p = (eta * cosine - inside) / (eta * cosine + inside)
    assert_close(reference.fresnel_conductor(np.array([cosine]), eta, 0.0), [(s**2 + p**2) / 2], 64 * U)


def test_fresnel_spot_values() -> None:
    # Glass at Brewster's angle reflects s-polarised light alone: ((n² − 1)/(n² + 1))² / 2.
    n = 1.5
    brewster = np.array([np.cos(np.arctan(n))])
    assert_close(reference.fresnel_conductor(brewster, n, 0.0), [((n**2 - 1) / (n**2 + 1)) ** 2 / 2], 64 * U)
    # Everything reflects fully at grazing incidence, and beyond the critical angle from a denser medium.
    assert_close(reference.fresnel_conductor(np.array([0.0]), [0.2, 1.5, 3], [3.0, 0, 1]), np.ones(3), 8 * U)
    assert_close(reference.fresnel_conductor(np.array([0.3]), 1 / 1.5, 0.0), [1.0], 8 * U)


def test_fresnel_never_exceeds_one() -> None:
    rng = np.random.default_rng(10)
    f = reference.fresnel_conductor(
        rng.uniform(0, 1, 5000), rng.uniform(0.01, 10, 5000), rng.uniform(0, 10, 5000)
    )
    assert (f >= 0).all()
    assert (f <= 1 + 8 * U).all()


def test_schlick_ends() -> None:
    f0 = np.array([0.04, 0.5, 1.0])
    assert (reference.fresnel_schlick(np.array([1.0]), f0) == f0).all()
    assert (reference.fresnel_schlick(np.array([0.0]), f0) == 1).all()
    assert_close(reference.fresnel_schlick(np.array([0.5]), 0.0), [2.0**-5], 0.0)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 10.0, 100.0, 1000.0])
def test_blinn_albedo_at_normal_incidence_is_ks(exponent: float) -> None:
    """∫ f cosθ dω with v = n: θ_h = θ/2, so (n·h)^n = ((1 + cos θ)/2)^(n/2) and 260 nodes do."""
    nodes, weights = np.polynomial.legendre.leggauss(260)
    cosine = (nodes + 1) / 2
    incident = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], axis=1)
    material = {"kind": "blinn", "exponent": exponent, "ks": np.array([0.2, 0.6, 1.0]), "kd": 0.0}
    f = reference.brdf(material, incident, np.array([0.0, 0.0, 1.0]))
    total = (f * (cosine * weights / 2)[:, None]).sum(axis=0) * 2 * np.pi
    assert_close(total, [0.2, 0.6, 1.0], 1e-10)


def test_table_at_nodes_between_and_outside() -> None:
    values = np.arange(12.0).reshape(2, 2, 3)
    table = {"kind": "table", "values": values, "theta_h": [0.2, 0.6], "theta_d": [0.3, 0.7]}

    def at(theta_h: float, theta_d: float) -> NDArray[np.float64]:
        # The half vector lies in the xz plane, the difference across it.
        h = np.array([np.sin(theta_h), 0.0, np.cos(theta_h)])
        across = np.array([0.0, 1.0, 0.0])
        i, o = (np.cos(theta_d) * h + sign * np.sin(theta_d) * across for sign in (1, -1))
        return reference.brdf(table, i, o)

    assert_close(at(0.2, 0.3), values[0, 0], 1e-13, zeros=0.5)
    assert_close(at(0.6, 0.7), values[1, 1], 1e-12)
    assert_close(at(0.4, 0.3), values[:, 0].mean(axis=0), 1e-12)
    low, high = (0.25 * values[row, 0] + 0.75 * values[row, 1] for row in (0, 1))
    assert_close(at(0.3, 0.6), 0.75 * low + 0.25 * high, 1e-12)
    assert_close(at(0.05, 0.1), values[0, 0], 1e-13, zeros=0.5)  # clamped outside
    assert_close(at(0.9, 0.9), values[1, 1], 1e-12)


def test_radiance_of_a_lambert_surface_under_a_constant_sky() -> None:
    frame = np.eye(3)[[0, 2, 1]] * np.array([[1], [-1], [1]])  # normal +y
    image = np.full((4, 8, 3), 2.0)
    got = reference.radiance(image, {"kind": "lambert", "albedo": 0.6}, frame, [0.0, 1.0, 0.0], levels=5)
    # The midpoint rule's mean cosine is 1/2 + 1/4**levels (test_moments_of_the_hemisphere).
    assert_close(got, np.full(3, 1.2 * (1 + 2 / 4**5)), 64 * U)

    def ceiling(origins: NDArray[np.float32], towards: NDArray[np.float32]) -> NDArray[np.bool_]:
        assert origins.shape == towards.shape
        return towards[:, 0] > 0

    half = reference.radiance(
        image, {"kind": "lambert", "albedo": 0.6}, frame, [0.0, 1.0, 0.0], levels=5, occluded=ceiling
    )
    assert_close(half, got / 2, 4**5 * U)
