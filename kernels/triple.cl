// SPDX-License-Identifier: MIT
// The reduced coefficients a (+) b of two functions given by their Haar coefficients, through the tree.
//
// Source: Sitthi-Amorn, Romeiro, Zickler, Lawrence, "Factoring Lighting, Visibility, and Bivariate Reflectance
// for Interactive Editing", supplemental; tripling coefficients of Ng, Ramamoorthi, Hanrahan 2004.
//
//  +----------------------------------------------------------------------------------------------------------+
//  | C_ijk = sum of rho_i rho_j rho_k is not zero only for                                                    |
//  |   1. three scaling functions                                                   2^(-R)                    |
//  |   2. the three different wavelets of one square of level r                     2^(r-R)                   |
//  |   3. two identical ones and a coarser overlapping function of level r          +- 2^(r-R)                |
//  |                                                                                                          |
//  | psum(a; r,s) = sum over coarser j' of sign(j') 2^(r'-R) a_j'   the mean of a over the square             |
//  | E(r,s)       = sum_M a_M b_M + sum of E over the four children                                           |
//  |                                                                                                          |
//  | (a (+) b)_j  = 2^(r-R) (a_j+ b_j- + a_j- b_j+)      case 2                                               |
//  |              + a_j psum(b) + b_j psum(a)            case 3, j one of the identical two      -> K_j       |
//  |              + 2^(r-R) sum_c sign_M(c) E(c)         case 3, j the coarser one               -> G_j       |
//  | (a (+) b)_0  = 2^(-R) (a_0 b_0 + E(root))                                                                |
//  |                                                                                                          |
//  | The supplemental prints G_j with 2^(r-r'), r' the finer level. Its derivation loses the 2^(-R+r') before |
//  | the parent sum; the product of the two is the 2^(r-R) above.                                             |
//  +----------------------------------------------------------------------------------------------------------+
//
// One launch a level: psum top-down, then E and the result bottom-up. No float atomics, fixed order of every sum.
//
//   a           n_points * CHANNELS rows of 4^R REALs
//   b           n_points * CHANNELS_B rows (CHANNELS, or 1 shared by all channels)
//   psum, energy  rows of (4^R - 1)/3 ACCs, one a square
//   dst         n_points * CHANNELS rows of 4^keep REALs: levels at and above `keep` are summed, not written
//   launch      4^level work-items in x, rows in y
//   work        28 flops for a psum square, 45 for a result square

#include "common.clh"
#include "quadtree.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of a and b>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=<rows of a per point>"
#endif
#ifndef CHANNELS_B
  #error "CHANNELS_B: pass -D CHANNELS_B=<rows of b per point, CHANNELS or 1>"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// Parent sums of level + 1 from those of `level`; level 0 also writes the root, 2^(-R) a_0.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void parent_sums(const global REAL *restrict src, global ACC *restrict psum, const int level)
{
    const int index = (int)get_global_id(0);
    const size_t row = get_global_id(1);
    if (index >= N_SAMPLES(level))
        return;
    const global REAL *a = src + row * N_SAMPLES(LEVELS);
    global ACC *sums = psum + row * N_SQUARES(LEVELS);
    const ACC own = pow2(level - LEVELS);
    const ACC here = (level == 0) ? own * (ACC)a[0] : sums[square_at(level, index)];
    if (level == 0)
        sums[0] = here;
    if (level + 1 < LEVELS) {
        const global REAL *detail = a + coefficient_at(level, index);
        const ACC4 children = butterfly(
            (ACC4)(here, own * (ACC)detail[0], own * (ACC)detail[1], own * (ACC)detail[2]));
        global ACC *at = sums + square_at(level + 1, 4 * index);
        at[0] = children.s0;
        at[1] = children.s1;
        at[2] = children.s2;
        at[3] = children.s3;
    }
}

// E and a (+) b of one level, from the E of the next finer one.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void triple_accumulate(const global REAL *restrict a, const global REAL *restrict b,
                       const global ACC *restrict psum_a, const global ACC *restrict psum_b,
                       global ACC *restrict energy, global REAL *restrict dst, const int level, const int keep)
{
    const int index = (int)get_global_id(0);
    const size_t row = get_global_id(1);
    if (index >= N_SAMPLES(level))
        return;
    const size_t row_b = (CHANNELS_B == 1) ? row / CHANNELS : row;
    const int here = square_at(level, index);
    const global REAL *at_a = a + row * N_SAMPLES(LEVELS) + coefficient_at(level, index);
    const global REAL *at_b = b + row_b * N_SAMPLES(LEVELS) + coefficient_at(level, index);
    const ACC a1 = at_a[0], a2 = at_a[1], a3 = at_a[2];
    const ACC b1 = at_b[0], b2 = at_b[1], b3 = at_b[2];

    ACC4 below = (ACC4)((ACC)0);        // sums of E with the signs of the scaling function and M = 1, 2, 3
    if (level + 1 < LEVELS) {
        const global ACC *child = energy + row * N_SQUARES(LEVELS) + square_at(level + 1, 4 * index);
        below = butterfly((ACC4)(child[0], child[1], child[2], child[3]));
    }
    const ACC total = (a1 * b1 + a2 * b2) + (a3 * b3 + below.s0);
    energy[row * N_SQUARES(LEVELS) + here] = total;

    if (level < keep) {
        const ACC own = pow2(level - LEVELS);
        const ACC sum_a = psum_a[row * N_SQUARES(LEVELS) + here];
        const ACC sum_b = psum_b[row_b * N_SQUARES(LEVELS) + here];
        global REAL *at = dst + row * N_SAMPLES(keep) + coefficient_at(level, index);
        at[0] = TO_REAL(own * (a2 * b3 + a3 * b2 + below.s1) + (a1 * sum_b + b1 * sum_a));
        at[1] = TO_REAL(own * (a3 * b1 + a1 * b3 + below.s2) + (a2 * sum_b + b2 * sum_a));
        at[2] = TO_REAL(own * (a1 * b2 + a2 * b1 + below.s3) + (a3 * sum_b + b3 * sum_a));
    }
    if (level == 0) {
        const ACC a0 = a[row * N_SAMPLES(LEVELS)], b0 = b[row_b * N_SAMPLES(LEVELS)];
        dst[row * N_SAMPLES(keep)] = TO_REAL(pow2(-LEVELS) * (a0 * b0 + total));
    }
}

// Plain twin of both: one work-item a row, every square in turn, psum recomputed from the root for each.
// `energy` is a row's private scratch as above. Launch: n_rows work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void triple_plain(const global REAL *restrict a, const global REAL *restrict b, global ACC *restrict energy,
                  global REAL *restrict dst, const int n_rows)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n_rows)
        return;
    const global REAL *ra = a + row * N_SAMPLES(LEVELS);
    const global REAL *rb = b + (CHANNELS_B == 1 ? row / CHANNELS : row) * N_SAMPLES(LEVELS);
    global ACC *e = energy + row * N_SQUARES(LEVELS);
    global REAL *out = dst + row * N_SAMPLES(LEVELS);
    for (int level = LEVELS - 1; level >= 0; --level)
        for (int s = 0; s < N_SAMPLES(level); ++s) {
            ACC sum_a = pow2(-LEVELS) * (ACC)ra[0], sum_b = pow2(-LEVELS) * (ACC)rb[0];
            for (int r = 0; r < level; ++r) {
                const int parent = s >> (2 * (level - r));
                const int child = (s >> (2 * (level - r - 1))) & 3;
                for (int m = 1; m <= 3; ++m) {
                    const ACC value = (popcount(m & child) & 1) ? -pow2(r - LEVELS) : pow2(r - LEVELS);
                    sum_a += value * (ACC)ra[coefficient_at(r, parent) + m - 1];
                    sum_b += value * (ACC)rb[coefficient_at(r, parent) + m - 1];
                }
            }
            const int j = coefficient_at(level, s);
            ACC total = (ACC)0;
            for (int m = 0; m < 3; ++m) {
                const int plus = j + (m + 1) % 3, minus = j + (m + 2) % 3;
                ACC g = (ACC)0;
                for (int c = 0; c < 4 && level + 1 < LEVELS; ++c) {
                    const ACC below = e[square_at(level + 1, 4 * s + c)];
                    g += (popcount((m + 1) & c) & 1) ? -below : below;
                    total += (m == 0) ? below : (ACC)0;
                }
                const ACC k = pow2(level - LEVELS)
                              * ((ACC)ra[plus] * (ACC)rb[minus] + (ACC)ra[minus] * (ACC)rb[plus]);
                out[j + m] = TO_REAL(k + (ACC)ra[j + m] * sum_b + (ACC)rb[j + m] * sum_a
                                     + pow2(level - LEVELS) * g);
                total += (ACC)ra[j + m] * (ACC)rb[j + m];
            }
            e[square_at(level, s)] = total;
        }
    out[0] = TO_REAL(pow2(-LEVELS) * ((ACC)ra[0] * (ACC)rb[0] + (LEVELS > 0 ? e[0] : (ACC)0)));
}
