// SPDX-License-Identifier: MIT
// Visibility bits to Haar coefficients, by counting: every sum is an integer, every result exact.
//
// A wavelet of level r is +-2^(r-R) on its square, so with n_c the visible samples of child c
//
//     v_(r,s),M = 2^(r-R) * (sum over c of sign_M(c) n_c)          v_0 = 2^(-R) * (sum over c of n_c)
//
// which float32 holds exactly up to R = 11. A work-item owns a square of level BITS - DEPTH, whose 4^DEPTH <= 64
// bits lie in two words, and writes its DEPTH levels; `means` (2^-DEPTH times the count, still exact) go on to
// haar_forward for the coarser levels.
//
// The bits may be of a coarser grid (BITS levels) than the coefficients (LEVELS levels): visibility is then
// constant in the finer squares, whose details are zero, and its coefficients grow by 2^(LEVELS-BITS).
//
//   bits      n_points rows of `words` uints; sample s is bit s % 32 of word s / 32; 1 is visible
//   dst       n_points rows of 4^LEVELS REALs
//   means     n_points rows of 4^(BITS-DEPTH) REALs
//   launch    n_points * 4^(BITS-DEPTH) work-items in groups of GROUP
//   work      21 squares of 4 popcounts for DEPTH = 3; 8 bytes read, 64 REALs written

#include "common.clh"
#include "quadtree.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the coefficients>"
#endif
#ifndef BITS
  #error "BITS: pass -D BITS=<levels of the visibility grid, at most LEVELS>"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// Derived
#define DEPTH (BITS < 3 ? BITS : 3)
#define TOP (BITS - DEPTH)
#define WORDS (BITS < 3 ? 1 : N_SAMPLES(BITS) / 32)

inline int count_bits(const ulong run, const int first, const int length)
{
    const ulong mask = (length == 64) ? ~0UL : ((1UL << length) - 1UL);
    return (int)popcount((run >> first) & mask);
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void visibility_coefficients(const global uint *restrict bits, global REAL *restrict dst,
                             global REAL *restrict means, const int n_points)
{
    const size_t item = get_global_id(0);
    const size_t point = item / N_SAMPLES(TOP);
    const int index = (int)(item % N_SAMPLES(TOP));
    if (point >= (size_t)n_points)
        return;

    const global uint *words = bits + point * WORDS;
    ulong run = words[(BITS < 3) ? 0 : 2 * index];
    if (BITS >= 3)
        run |= (ulong)words[2 * index + 1] << 32;

    global REAL *coefficients = dst + point * N_SAMPLES(LEVELS);
    const REAL grow = TO_REAL(pow2(LEVELS - BITS));
    for (int depth = 0; depth < DEPTH; ++depth) {
        const REAL value = grow * TO_REAL(pow2(TOP + depth - BITS));
        const int quarter = N_SAMPLES(DEPTH - depth - 1);
        for (int i = 0; i < N_SAMPLES(depth); ++i) {
            const int first = 4 * quarter * i;
            const int n0 = count_bits(run, first, quarter), n1 = count_bits(run, first + quarter, quarter);
            const int n2 = count_bits(run, first + 2 * quarter, quarter);
            const int n3 = count_bits(run, first + 3 * quarter, quarter);
            global REAL *at = coefficients + coefficient_at(TOP + depth, index * N_SAMPLES(depth) + i);
            at[0] = value * (REAL)(n0 - n1 + n2 - n3);
            at[1] = value * (REAL)(n0 + n1 - n2 - n3);
            at[2] = value * (REAL)(n0 - n1 - n2 + n3);
        }
    }
    // Constant below the visibility grid: this work-item's share of the finer levels is zero.
    for (int level = BITS; level < LEVELS; ++level) {
        const int share = 3 * N_SAMPLES(level) / N_SAMPLES(TOP);
        for (int i = 0; i < share; ++i)
            coefficients[N_SAMPLES(level) + index * share + i] = (REAL)0;
    }
    const REAL mean = grow * TO_REAL(pow2(-DEPTH)) * (REAL)count_bits(run, 0, N_SAMPLES(DEPTH));
    if (TOP == 0)
        coefficients[0] = mean;
    else
        means[item] = mean;
}

// Plain twin: one work-item a point and coefficient, sums over the samples of its square.
// Launch: 4^LEVELS work-items in x, n_points in y.
inline int visible(const global uint *words, const int sample)
{
    const int bit = sample >> (2 * (LEVELS - BITS));
    return (int)((words[bit / 32] >> (bit % 32)) & 1u);
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void visibility_coefficients_plain(const global uint *restrict bits, global REAL *restrict dst)
{
    const int j = (int)get_global_id(0);
    const size_t point = get_global_id(1);
    if (j >= N_SAMPLES(LEVELS))
        return;
    const global uint *words = bits + point * WORDS;
    int level = 0;
    while (j >= N_SAMPLES(level + 1))
        ++level;
    const int square = (j == 0) ? 0 : (j - N_SAMPLES(level)) / 3;
    const int wavelet = (j == 0) ? 0 : (j - N_SAMPLES(level)) % 3 + 1;
    const int run = N_SAMPLES(LEVELS - level);
    int sum = 0;
    for (int i = 0; i < run; ++i) {
        const int child = (run > 1) ? i / (run / 4) : 0;
        const int sign = (popcount(wavelet & child) & 1) ? -1 : 1;
        sum += sign * visible(words, square * run + i);
    }
    dst[point * N_SAMPLES(LEVELS) + j] = TO_REAL(pow2(level - LEVELS)) * (REAL)sum;
}
