// SPDX-License-Identifier: MIT
// Plain twins of haar.cl: one work-item a row, one level after another, loops only.
//
//   src, dst   n_rows rows of 4^levels REALs
//   scratch    as large as src
//   launch     n_rows work-items in groups of GROUP

#include "common.clh"
#include "quadtree.clh"

// Tunables
#ifndef GROUP
  #define GROUP 8       // work-items a group
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void haar_forward_plain(const global REAL *restrict src, global REAL *restrict dst, global REAL *restrict scratch,
                        const int n_rows, const int levels)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n_rows)
        return;
    const size_t base = row * N_SAMPLES(levels);
    for (int i = 0; i < N_SAMPLES(levels); ++i)
        scratch[base + i] = src[base + i];
    for (int level = levels - 1; level >= 0; --level)
        for (int s = 0; s < N_SAMPLES(level); ++s) {
            ACC4 x = (ACC4)(scratch[base + 4 * s], scratch[base + 4 * s + 1], scratch[base + 4 * s + 2],
                            scratch[base + 4 * s + 3]);
            const ACC4 y = (ACC)0.5 * butterfly(x);
            scratch[base + s] = TO_REAL(y.s0);
            dst[base + coefficient_at(level, s)] = TO_REAL(y.s1);
            dst[base + coefficient_at(level, s) + 1] = TO_REAL(y.s2);
            dst[base + coefficient_at(level, s) + 2] = TO_REAL(y.s3);
        }
    dst[base] = scratch[base];
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void haar_inverse_plain(const global REAL *restrict src, global REAL *restrict dst, const int n_rows,
                        const int levels)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n_rows)
        return;
    const size_t base = row * N_SAMPLES(levels);
    dst[base] = src[base];
    for (int level = 0; level < levels; ++level)
        for (int s = N_SAMPLES(level) - 1; s >= 0; --s) {
            const size_t at = base + coefficient_at(level, s);
            const ACC4 y = (ACC)0.5 * butterfly((ACC4)(dst[base + s], src[at], src[at + 1], src[at + 2]));
            dst[base + 4 * s] = TO_REAL(y.s0);
            dst[base + 4 * s + 1] = TO_REAL(y.s1);
            dst[base + 4 * s + 2] = TO_REAL(y.s2);
            dst[base + 4 * s + 3] = TO_REAL(y.s3);
        }
}
