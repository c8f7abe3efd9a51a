// SPDX-License-Identifier: MIT
// The inner product of shade.cl for CPUs: sixteen coefficients at a time, one point after another.
//
// Points that share a slice should follow each other: it then stays in the cache, and only the reduced coefficients
// come from memory.
//
//   launch      n_points / POINTS work-items, rounded up, in groups of one; KEEP at least 2; all else as in shade.cl
//   rounding    thirty-two sums of 4^KEEP / 32 terms in order, then a tree of 5 levels

#include "common.clh"
#include "quadtree.clh"
#include "wide.clh"

// Problem constants
#ifndef KEEP
  #error "KEEP: pass -D KEEP=<levels of the reduced coefficients, at least 2>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3, of the reduced coefficients"
#endif
#ifndef SLICE_CHANNELS
  #error "SLICE_CHANNELS: pass -D SLICE_CHANNELS=1 or 3"
#endif
#ifndef N_SLICES
  #error "N_SLICES: pass -D N_SLICES=<slices interpolated per point>"
#endif

// Tunables
#ifndef POINTS
  #define POINTS 8      // points a work-item
#endif

// What is counted in small constants is to stay in registers.
#define UNROLL _Pragma("unroll")

// Derived
#define ROW_SIZE N_SAMPLES(KEEP)
#define SUMS (CHANNELS > SLICE_CHANNELS ? CHANNELS : SLICE_CHANNELS)

inline ACC total16(const ACC16 x)
{
    const JOIN(ACC, 8) a = x.lo + x.hi;
    const ACC4 b = a.lo + a.hi;
    return (b.x + b.z) + (b.y + b.w);
}

// Sixteen values of f_v, interpolated.
inline ACC16 slice16(const global REAL *const *slice, const ACC *share, const int at)
{
    ACC16 f = share[0] * load16(slice[0] + at);
    UNROLL
    for (int k = 1; k < N_SLICES; ++k)
        f += share[k] * load16(slice[k] + at);
    return f;
}

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void inner_product_wide(const global REAL *restrict reduced, const global REAL *restrict slices,
                        const global int *restrict index, const global REAL *restrict weight,
                        global REAL4 *restrict dst, const REAL scale, const int add, const int n_points)
{
    const size_t first = get_global_id(0) * POINTS;
    for (size_t point = first; point < min(first + POINTS, (size_t)n_points); ++point) {
        const global REAL *coefficients = reduced + point * CHANNELS * ROW_SIZE;
        const global REAL *slice[N_SLICES];
        ACC share[N_SLICES];
        for (int k = 0; k < N_SLICES; ++k) {
            slice[k] = slices + (size_t)index[point * N_SLICES + k] * SLICE_CHANNELS * ROW_SIZE;
            share[k] = (ACC)weight[point * N_SLICES + k];
        }
        // A channel after another, in two sums each: few streams at a time, and none waits for the other's addition.
        ACC total[SUMS];
        for (int c = 0; c < SUMS; ++c) {
            const global REAL *a = coefficients + (CHANNELS == 1 ? 0 : c) * ROW_SIZE;
            const int at = (SLICE_CHANNELS == 1 ? 0 : c) * ROW_SIZE;
            ACC16 even = (ACC16)((ACC)0), odd = (ACC16)((ACC)0);
            for (int j = 0; j < ROW_SIZE; j += 32) {
                even += load16(a + j) * slice16(slice, share, at + j);
                if (ROW_SIZE > 16)
                    odd += load16(a + j + 16) * slice16(slice, share, at + j + 16);
            }
            total[c] = total16(even + odd);
        }
        const REAL r = TO_REAL((ACC)scale * total[0]);
        const REAL g = TO_REAL((ACC)scale * total[SUMS == 1 ? 0 : 1]);
        const REAL b = TO_REAL((ACC)scale * total[SUMS == 1 ? 0 : 2]);
        const REAL4 radiance = (REAL4)(r, g, b, (REAL)0);
        dst[point] = add ? dst[point] + radiance : radiance;
    }
}
