// SPDX-License-Identifier: MIT
// Dense reduced coefficients for CPUs: every square of the tree at once, sixteen values at a time (wide.clh).
//
// In one square the sums over M of triple.cl are a product of two functions of four values each, so the butterfly of
// (psum(a) a1 a2 a3) times that of (psum(b) b1 b2 b3), value by value, turned back, is K and E together. Carried out
// from the root down and back up it is
//
//     a (+) b = haar(inverse(a) * inverse(b))
//
// of which nothing leaves private memory but the result. Products are taken where each function is smallest, so nothing
// is added that must cancel again (triple.cl's K and G do, where the brightest light is hidden).
//
//   a, light    n_points * CHANNELS rows of 4^LEVELS REALs: coefficients, or samples
//   b           n_points * CHANNELS_B rows of coefficients (CHANNELS, or 1 shared by all channels)
//   bits        n_points rows of visibility words (visibility.cl), of a grid of BITS <= LEVELS levels
//   dst         n_points * CHANNELS rows of 4^KEEP REALs: the coefficients below KEEP
//   launch      n_points work-items in groups of one
//   private     3 or 5 * 4^(LEVELS-1) ACCs: LEVELS from 3 to 7
//   work        16/3 additions a coefficient of a, one multiplication; each REAL moved once

#include "common.clh"
#include "quadtree.clh"
#include "wide.clh"
#include "mask_wide.clh"
#include "keep_wide.clh"

// Problem constants
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=<rows of a per point>"
#endif
#ifndef CHANNELS_B
  #error "CHANNELS_B: pass -D CHANNELS_B=<rows of b per point, CHANNELS or 1>"
#endif

// Derived
#define TOP_SIZE N_SAMPLES(LEVELS - 1)

// Sixty-four values of a where V lets them pass.
inline ACC16 fold_masked(ACC16 *p, const global uint *words, const int i, global REAL *row)
{
    for (int k = 0; k < 4; ++k)
        p[k] = masked16(p[k], mask16(words, 4 * i + 16 * k));
    return fold_kept(p[0], p[1], p[2], p[3], i, row);
}

// a (+) V from the coefficients of a.
kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void reduce_bits(const global REAL *restrict a, const global uint *restrict bits, global REAL *restrict dst,
                 const int n_points)
{
    const size_t point = get_global_id(0);
    const global uint *words = bits + point * WORDS;
    ACC x[TOP_SIZE], y[TOP_SIZE], sums[TOP_SIZE];
    for (int c = 0; c < CHANNELS; ++c) {
        const global REAL *row = a + (point * CHANNELS + c) * N_SAMPLES(LEVELS);
        const int more = c + 1 < CHANNELS || point + 1 < (size_t)n_points;
        global REAL *out = dst + (point * CHANNELS + c) * N_SAMPLES(KEEP);
        const ACC *values = unfold_row(row, LEVELS - 1, x, y);
        for (int i = 0; i < TOP_SIZE; i += 16) {
            if (more)
                fetch_ahead(row + N_SAMPLES(LEVELS) + 4 * i, 64);
            ACC16 p[4];
            unfold16(vload16(0, values + i), row + coefficient_at(LEVELS - 1, i), p);
            vstore16(fold_masked(p, words, i, out), 0, sums + i);
        }
        fold_rest(sums, out);
    }
}

// a (+) b of two rows of coefficients.
kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void reduce_pair(const global REAL *restrict a, const global REAL *restrict b, global REAL *restrict dst,
                 const int n_points)
{
    const size_t point = get_global_id(0);
    ACC x[TOP_SIZE], y[TOP_SIZE], u[TOP_SIZE], v[TOP_SIZE], sums[TOP_SIZE];
    const ACC *values_b = u;
    for (int c = 0; c < CHANNELS; ++c) {
        const global REAL *row = a + (point * CHANNELS + c) * N_SAMPLES(LEVELS);
        const global REAL *row_b = b + (point * CHANNELS_B + (CHANNELS_B == 1 ? 0 : c)) * N_SAMPLES(LEVELS);
        const int more = c + 1 < CHANNELS || point + 1 < (size_t)n_points;
        global REAL *out = dst + (point * CHANNELS + c) * N_SAMPLES(KEEP);
        if (c == 0 || CHANNELS_B > 1)
            values_b = unfold_row(row_b, LEVELS - 1, u, v);
        const ACC *values = unfold_row(row, LEVELS - 1, x, y);
        for (int i = 0; i < TOP_SIZE; i += 16) {
            if (more)
                fetch_ahead(row + N_SAMPLES(LEVELS) + 4 * i, 64);
            ACC16 p[4], q[4];
            unfold16(vload16(0, values + i), row + coefficient_at(LEVELS - 1, i), p);
            unfold16(vload16(0, values_b + i), row_b + coefficient_at(LEVELS - 1, i), q);
            for (int k = 0; k < 4; ++k)
                p[k] *= q[k];
            vstore16(fold_kept(p[0], p[1], p[2], p[3], i, out), 0, sums + i);
        }
        fold_rest(sums, out);
    }
}

// a (+) V from the samples of a.
kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void reduce_samples(const global REAL *restrict light, const global uint *restrict bits, global REAL *restrict dst,
                    const int n_points)
{
    const size_t point = get_global_id(0);
    const global uint *words = bits + point * WORDS;
    ACC sums[TOP_SIZE];
    for (int c = 0; c < CHANNELS; ++c) {
        const global REAL *row = light + (point * CHANNELS + c) * N_SAMPLES(LEVELS);
        const int more = c + 1 < CHANNELS || point + 1 < (size_t)n_points;
        global REAL *out = dst + (point * CHANNELS + c) * N_SAMPLES(KEEP);
        for (int i = 0; i < TOP_SIZE; i += 16) {
            if (more)
                fetch_ahead(row + N_SAMPLES(LEVELS) + 4 * i, 64);
            ACC16 p[4];
            for (int k = 0; k < 4; ++k)
                p[k] = load16(row + 4 * i + 16 * k);
            vstore16(fold_masked(p, words, i, out), 0, sums + i);
        }
        fold_rest(sums, out);
    }
}
