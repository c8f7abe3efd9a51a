// SPDX-License-Identifier: MIT
// Forward and inverse nonstandard orthonormal 2D Haar transform of Morton-ordered samples.
//
// One square of four values x0..x3 becomes a mean and three details (M = 01, 10, 11):
//
//     mean = (x0 + x1 + x2 + x3) / 2      detail_M = (sum of sign_M(c) x_c) / 2
//
// and the means of all squares are the values of the next coarser level. The matrix is symmetric and orthogonal,
// so the inverse is the same butterfly.
//
// A stage takes DEPTH levels at once: a work-item owns one square of level `top`, whose 4^DEPTH values are one
// contiguous run, keeps them in registers, and hands one mean to the next stage.
//
//   src, dst      n_rows rows of 4^levels values; coefficients by level (quadtree.clh)
//   means         n_rows rows of 4^top values, between stages
//   launch        n_rows * 4^top work-items in groups of GROUP
//   local memory  none
//   work          4^DEPTH * 8/3 additions a work-item; 2 * 4^DEPTH REALs moved
//   rounding      each level adds a relative error of at most 2 u: ||error|| <= 2 DEPTH u ||x||

#include "common.clh"
#include "quadtree.clh"

// Problem constants
#ifndef DEPTH
  #error "DEPTH: pass -D DEPTH=1, 2 or 3, the levels of one stage"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

// Derived
#define RUN N_SAMPLES(DEPTH)

// Values at src + row * src_stride (level top + DEPTH) to details in dst and means of level top.
// Where top is 0 the mean is the scaling coefficient and goes to dst.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void haar_forward(const global REAL *restrict src, const int src_stride, global REAL *restrict dst,
                  const int dst_stride, global REAL *restrict means, const int n_rows, const int top,
                  const REAL scale)
{
    const int squares = N_SAMPLES(top);
    const size_t item = get_global_id(0);
    const size_t row = item / squares;
    const int index = (int)(item % squares);
    if (row >= (size_t)n_rows)
        return;

    const global REAL *values = src + row * src_stride + (size_t)index * RUN;
    global REAL *details = dst + row * dst_stride;
    ACC x[RUN];
    for (int i = 0; i < RUN; ++i)
        x[i] = (ACC)(scale * values[i]);

    for (int depth = DEPTH - 1; depth >= 0; --depth) {
        const int run = N_SAMPLES(depth);
        for (int i = 0; i < run; ++i) {
            const ACC4 y = (ACC)0.5 * butterfly((ACC4)(x[4 * i], x[4 * i + 1], x[4 * i + 2], x[4 * i + 3]));
            global REAL *at = details + coefficient_at(top + depth, index * run + i);
            at[0] = TO_REAL(y.s1);
            at[1] = TO_REAL(y.s2);
            at[2] = TO_REAL(y.s3);
            x[i] = y.s0;
        }
    }
    if (top == 0)
        details[0] = TO_REAL(x[0]);
    else
        means[row * squares + index] = TO_REAL(x[0]);
}

// The way back: means of level top (the scaling coefficient where top is 0) and details to values of level
// top + DEPTH.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void haar_inverse(const global REAL *restrict src, const int src_stride, const global REAL *restrict means,
                  global REAL *restrict dst, const int n_rows, const int top)
{
    const int squares = N_SAMPLES(top);
    const size_t item = get_global_id(0);
    const size_t row = item / squares;
    const int index = (int)(item % squares);
    if (row >= (size_t)n_rows)
        return;

    const global REAL *details = src + row * src_stride;
    ACC x[RUN];
    x[0] = (top == 0) ? (ACC)details[0] : (ACC)means[row * squares + index];
    for (int depth = 0; depth < DEPTH; ++depth) {
        const int run = N_SAMPLES(depth);
        // From the last square to the first: square i's children lie at 4 i and beyond, so nothing unread is lost.
        for (int i = run - 1; i >= 0; --i) {
            const global REAL *at = details + coefficient_at(top + depth, index * run + i);
            const ACC4 y = (ACC)0.5 * butterfly((ACC4)(x[i], (ACC)at[0], (ACC)at[1], (ACC)at[2]));
            x[4 * i] = y.s0;
            x[4 * i + 1] = y.s1;
            x[4 * i + 2] = y.s2;
            x[4 * i + 3] = y.s3;
        }
    }
    global REAL *values = dst + (row * squares + index) * RUN;
    for (int i = 0; i < RUN; ++i)
        values[i] = TO_REAL(x[i]);
}
