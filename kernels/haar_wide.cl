// SPDX-License-Identifier: MIT
// The transforms of haar.cl for CPUs: sixteen values at a time (wide.clh), up to six levels in one pass.
//
// A work-item takes RUNS squares of level `top`, one after another. What lies between their levels stays in private
// memory, which is in the first-level cache. Arguments, layouts and bits of the results are those of haar.cl.
//
//   launch      n_rows * 4^top / RUNS work-items, rounded up, in groups of one
//   private     4^(DEPTH-1) ACCs forward, twice that back
//   work        4^DEPTH * 8/3 additions a square; 2 * 4^DEPTH REALs moved

#include "common.clh"
#include "quadtree.clh"
#include "wide.clh"

// Problem constants
#ifndef DEPTH
  #error "DEPTH: pass -D DEPTH=2 ... 6, the levels of one stage"
#endif

// Tunables
#ifndef RUNS
  #define RUNS 8        // squares a work-item
#endif

// Derived
#define RUN N_SAMPLES(DEPTH)

// Where the 3 * 4^depth details of square `index` of level `top` begin.
#define DETAILS(row, top, depth, index) ((row) + coefficient_at((top) + (depth), (index) * N_SAMPLES(depth)))

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void haar_forward_wide(const global REAL *restrict src, const int src_stride, global REAL *restrict dst,
                       const int dst_stride, global REAL *restrict means, const int n_rows, const int top,
                       const REAL scale)
{
    const int squares = N_SAMPLES(top);
    const size_t first = get_global_id(0) * RUNS, all = (size_t)n_rows * squares;
    for (size_t item = first; item < min(first + RUNS, all); ++item) {
        const size_t row = item / squares;
        const int index = (int)(item % squares);
        const global REAL *values = src + row * src_stride + (size_t)index * RUN;
        global REAL *details = dst + row * dst_stride;
        const int more = item + 1 < all && index + 1 < squares;     // the next run is in this row
        const global REAL *next = more ? values + RUN : src + (row + 1) * src_stride;
        ACC x[RUN / 4];
        for (int i = 0; i < RUN / 4; i += 16) {
            if (item + 1 < all)
                fetch_ahead(next + 4 * i, 64);
            if (DEPTH > 2) {
                const ACC16 sums = fold16((ACC)scale * load16(values + 4 * i), (ACC)scale * load16(values + 4 * i + 16),
                                          (ACC)scale * load16(values + 4 * i + 32),
                                          (ACC)scale * load16(values + 4 * i + 48),
                                          DETAILS(details, top, DEPTH - 1, index) + 3 * i);
                vstore16(sums, 0, x + i);
            }
        }
        for (int depth = DEPTH - 2; depth >= 2; --depth)
            for (int i = 0; i < N_SAMPLES(depth); i += 16) {
                const ACC16 sums = fold16(vload16(0, x + 4 * i), vload16(1, x + 4 * i), vload16(2, x + 4 * i),
                                          vload16(3, x + 4 * i), DETAILS(details, top, depth, index) + 3 * i);
                vstore16(sums, 0, x + i);
            }
        const ACC16 y = fold_top((DEPTH > 2) ? vload16(0, x) : (ACC)scale * load16(values));
        if (top == 0)
            stream16(y, details);
        else {
            means[item] = TO_REAL(y.s0);
            vstore3(JOIN(convert_, JOIN(REAL, 3))(y.s123), 0, DETAILS(details, top, 0, index));
            global REAL *below = DETAILS(details, top, 1, index);
            vstore8(JOIN(convert_, JOIN(REAL, 8))((JOIN(ACC, 8))(y.s456789ab)), 0, below);
            vstore4(JOIN(convert_, REAL4)(y.scdef), 2, below);
        }
    }
}

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void haar_inverse_wide(const global REAL *restrict src, const int src_stride, const global REAL *restrict means,
                       global REAL *restrict dst, const int n_rows, const int top)
{
    const int squares = N_SAMPLES(top);
    const size_t first = get_global_id(0) * RUNS, all = (size_t)n_rows * squares;
    for (size_t item = first; item < min(first + RUNS, all); ++item) {
        const size_t row = item / squares;
        const int index = (int)(item % squares);
        const global REAL *details = src + row * src_stride;
        const int more = item + 1 < all && index + 1 < squares;
        const global REAL *next = more ? details : details + src_stride;
        const int next_index = more ? index + 1 : 0;

        const global REAL *own = DETAILS(details, top, 0, index), *below = DETAILS(details, top, 1, index);
        const ACC mean = (top == 0) ? (ACC)details[0] : (ACC)means[item];
        const ACC16 y = (ACC16)(mean, (ACC)own[0], (ACC)own[1], (ACC)own[2],
                                JOIN(convert_, JOIN(ACC, 8))(vload8(0, below)),
                                JOIN(convert_, ACC4)(vload4(2, below)));
        ACC one[RUN / 4], two[RUN / 4];
        ACC *x = one, *z = two;
        const ACC16 top_values = unfold_top(y);
        global REAL *values = dst + (row * squares + index) * RUN;
        if (DEPTH == 2) {
            stream16(top_values, values);
            continue;
        }
        vstore16(top_values, 0, x);
        for (int depth = 2; depth < DEPTH - 1; ++depth) {
            for (int i = 0; i < N_SAMPLES(depth); i += 16) {
                ACC16 out[4];
                unfold16(vload16(0, x + i), DETAILS(details, top, depth, index) + 3 * i, out);
                for (int k = 0; k < 4; ++k)
                    vstore16(out[k], k, z + 4 * i);
            }
            ACC *last = x;
            x = z;
            z = last;
        }
        const global REAL *finest = DETAILS(details, top, DEPTH - 1, index);
        const global REAL *ahead = DETAILS(next, top, DEPTH - 1, next_index);
        for (int i = 0; i < RUN / 4; i += 16) {
            if (item + 1 < all)
                fetch_ahead(ahead + 3 * i, 48);
            ACC16 out[4];
            unfold16(vload16(0, x + i), finest + 3 * i, out);
            for (int k = 0; k < 4; ++k)
                stream16(out[k], values + 4 * i + 16 * k);
        }
    }
}
