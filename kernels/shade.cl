// SPDX-License-Identifier: MIT
// Radiance as the inner product of reduced coefficients and BRDF slices, equation (5):
//
//     I_p = scale * sum over j of (L (+) V)_j f_v,j
//
// f_v is interpolated linearly between N_SLICES stored slices: slice indices and weights come with each point.
//
//   reduced     n_points * CHANNELS rows of 4^KEEP REALs
//   slices      rows of 4^KEEP REALs, SLICE_CHANNELS (1 or CHANNELS) a slice
//   index       N_SLICES ints a point; weight: N_SLICES REALs a point
//   dst         n_points REAL4: RGB and 0; added to when `add` is set
//   launch      one work-group of GROUP a point: GROUP work-items in x, points in y
//   local       4 * GROUP ACCs
//   work        2 * CHANNELS * (N_SLICES + 1) flops and (CHANNELS + N_SLICES * SLICE_CHANNELS) REALs a coefficient
//   rounding    each work-item adds 4^KEEP / GROUP terms in order, then a tree of log2(GROUP) levels:
//               |error| <= (4^KEEP / GROUP + log2 GROUP + 3) u * sum |c_j f_j|; two runs agree bit for bit

#include "common.clh"
#include "quadtree.clh"

// Problem constants
#ifndef KEEP
  #error "KEEP: pass -D KEEP=<levels of the reduced coefficients>"
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
#ifndef GROUP
  #define GROUP 64      // work-items a point, a power of two
#endif

// Row of a channel where there may be one row for all three.
#define ROW(channels, c) ((channels) == 1 ? 0 : (c))

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void inner_product(const global REAL *restrict reduced, const global REAL *restrict slices,
                   const global int *restrict index, const global REAL *restrict weight, global REAL4 *restrict dst,
                   const REAL scale, const int add)
{
    local ACC4 partial[GROUP];
    const int lane = (int)get_local_id(0);
    const size_t point = get_global_id(1);
    const global REAL *coefficients = reduced + point * CHANNELS * N_SAMPLES(KEEP);

    ACC sum[3] = {(ACC)0, (ACC)0, (ACC)0};
    for (int j = lane; j < N_SAMPLES(KEEP); j += GROUP) {
        ACC f[SLICE_CHANNELS];
        for (int c = 0; c < SLICE_CHANNELS; ++c)
            f[c] = (ACC)0;
        for (int k = 0; k < N_SLICES; ++k) {
            const global REAL *slice
                = slices + (size_t)index[point * N_SLICES + k] * SLICE_CHANNELS * N_SAMPLES(KEEP) + j;
            for (int c = 0; c < SLICE_CHANNELS; ++c)
                f[c] += (ACC)weight[point * N_SLICES + k] * (ACC)slice[c * N_SAMPLES(KEEP)];
        }
        for (int c = 0; c < 3; ++c)
            sum[c] += (ACC)coefficients[ROW(CHANNELS, c) * N_SAMPLES(KEEP) + j] * f[ROW(SLICE_CHANNELS, c)];
    }
    partial[lane] = (ACC4)(sum[0], sum[1], sum[2], (ACC)0);
    for (int half_group = GROUP / 2; half_group > 0; half_group /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < half_group)
            partial[lane] += partial[lane + half_group];
    }
    if (lane == 0) {
        const ACC4 total = (ACC)scale * partial[0];
        const REAL4 radiance = (REAL4)(TO_REAL(total.s0), TO_REAL(total.s1), TO_REAL(total.s2), (REAL)0);
        dst[point] = add ? dst[point] + radiance : radiance;
    }
}

// Plain twin: one work-item a point, one coefficient after another. Launch: n_points work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void inner_product_plain(const global REAL *restrict reduced, const global REAL *restrict slices,
                         const global int *restrict index, const global REAL *restrict weight,
                         global REAL4 *restrict dst, const REAL scale, const int n_points)
{
    const size_t point = get_global_id(0);
    if (point >= (size_t)n_points)
        return;
    ACC sum[3] = {(ACC)0, (ACC)0, (ACC)0};
    for (int c = 0; c < 3; ++c)
        for (int k = 0; k < N_SLICES; ++k)
            for (int j = 0; j < N_SAMPLES(KEEP); ++j) {
                const size_t a = (point * CHANNELS + ROW(CHANNELS, c)) * N_SAMPLES(KEEP) + j;
                const size_t f = ((size_t)index[point * N_SLICES + k] * SLICE_CHANNELS + ROW(SLICE_CHANNELS, c))
                                 * N_SAMPLES(KEEP) + j;
                sum[c] += (ACC)weight[point * N_SLICES + k] * (ACC)reduced[a] * (ACC)slices[f];
            }
    dst[point] = (REAL4)(TO_REAL(scale * sum[0]), TO_REAL(scale * sum[1]), TO_REAL(scale * sum[2]), (REAL)0);
}
