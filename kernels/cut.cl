// SPDX-License-Identifier: MIT
// Radiance from packed parent sums over a cut of the quadtree: equation (5) with f_v constant on the cut's leaves.
//
//     I_p = sum over leaves of f(d_leaf, v) (n.d_leaf) omega_leaf psum(L (+) V; leaf)
//
// f is evaluated at each leaf's middle for the point's own view: no slices, nothing to interpolate. Which squares are
// leaves depends on the lobe's width and on the bin of the view (prtcl/transport/cut.py). The grid has the symmetry of
// the square and f is isotropic, so cuts are kept for views with x >= y >= 0 only: other views are turned there, and
// their leaves' sums are found where the turn puts them.
//
//   ints, reals, tables   materials (brdf.clh)
//   material              one index a point of the mesh
//   leaves                n_leaves REAL4, of all bins and cuts: a leaf's middle direction; w = mean cosine * solid angle
//   squares               8 rows of n_leaves ints: the leaf's square under each turn (0 is the identity)
//   starts                (BINS + 1) ints a material: its leaves for a bin are starts[bin] ... starts[bin + 1] - 1
//   sums                  one row of packed parent sums a point of the mesh (pyramid.cl)
//   chosen, views         the points wanted and their local views, n_chosen ints and REAL4
//   dst                   n_chosen REAL4, RGB and 0, times `scale`; added to where `add`
//   launch                one work-group of GROUP a chosen point: GROUP work-items in x, chosen points in y
//   local                 GROUP ACC4
//   work                  about 100 flops (GGX), 4 bytes of `sums` a leaf; 100 to 400 leaves a point
//   rounding              count / GROUP terms in order, then a tree, walked by one work-item behind a single barrier
//                         (a barrier a step took a third longer on a CPU): two runs agree bit for bit

#include "common.clh"
#include "quadtree.clh"
#include "shared_exponent.clh"
#include "brdf.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the product>"
#endif
#ifndef SIDE
  #error "SIDE: pass -D SIDE=<view bins along the square's side, even>"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 16      // work-items a point, a power of two
#endif

// Derived
#define N_NODES N_SQUARES(LEVELS + 1)
#define LINE 16         // uints of a cache line
#define COARSE min(N_NODES, N_SQUARES(5))   // squares of the first levels, a quarter of which a cut looks at
#define BINS ((SIDE / 2) * (SIDE / 2 + 1) / 2)

// The view turned to x >= y >= 0, and which of the eight turns takes leaves from there back: bit 0 mirrors x, bit 1
// mirrors y, bit 2 swaps them first.
inline REAL4 canonical(const REAL4 view, int *turn)
{
    const REAL x = fabs(view.x), y = fabs(view.y);
    const int swap = y > x;
    *turn = (view.x < (REAL)0) | ((view.y < (REAL)0) << 1) | (swap << 2);
    return (REAL4)(swap ? y : x, swap ? x : y, view.z, (REAL)0);
}

// Bin of a canonical view: rows 0 ... SIDE/2 - 1 of a triangle, columns up to the row.
inline int bin_of(const REAL4 view)
{
    const REAL radius = sqrt(fmax((REAL)1 - view.z, (REAL)0));
    const REAL ratio = (view.x > (REAL)0) ? atan2(view.y, view.x) * ((REAL)4 * INV_PI) : (REAL)0;
    const int row = clamp((int)(radius * (SIDE / 2)), 0, SIDE / 2 - 1);
    const int column = clamp((int)(radius * ratio * (SIDE / 2)), 0, row);
    return row * (row + 1) / 2 + column;
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void shade_cut(const global int *restrict ints, const global REAL *restrict reals, const global REAL *restrict tables,
               const global int *restrict material, const global REAL4 *restrict leaves,
               const global int *restrict squares, const int n_leaves, const global int *restrict starts,
               const global uint *restrict sums, const global int *restrict chosen, const global REAL4 *restrict views,
               global REAL4 *restrict dst, const REAL scale, const int add)
{
    local ACC4 partial[GROUP];
    const int lane = (int)get_local_id(0);
    const size_t item = get_global_id(1);
    const int point = chosen[item];
    const int own = material[point];
    int turn;
    const REAL4 view = canonical(views[item], &turn);
    const global int *bin = starts + own * (BINS + 1) + bin_of(view);
    const global int *square = squares + (size_t)turn * n_leaves;
    const global uint *row = sums + (size_t)point * N_NODES;
    const int first = bin[0], last = (view.z > (REAL)0) ? bin[1] : bin[0];

    // Rows lie so far apart that nothing foresees the next one: its coarse squares are fetched, and the finer ones at
    // which this point looks and the next most often does, too. A CPU waits three times as long without.
    const size_t last_item = get_global_offset(1) + get_global_size(1) - 1;
    const global uint *next = sums + (size_t)chosen[min(item + 1, last_item)] * N_NODES;
    for (int i = LINE * lane; i < COARSE; i += LINE * GROUP)
        prefetch(next + i, 1);

    ACC4 sum = (ACC4)((ACC)0);
    for (int k = first + lane; k < last; k += GROUP) {
        if (square[k] >= COARSE)
            prefetch(next + square[k], 1);
        const REAL4 d = leaves[k];
        const float4 mean = unpack_rgb(row[square[k]]);
        const REAL4 f = d.w * brdf(ints + own * MATERIAL_INTS, reals + own * MATERIAL_REALS, tables, d, view);
        sum += (ACC4)((ACC)f.x * (ACC)mean.x, (ACC)f.y * (ACC)mean.y, (ACC)f.z * (ACC)mean.z, (ACC)0);
    }
    partial[lane] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lane == 0) {
        for (int half_group = GROUP / 2; half_group > 0; half_group /= 2)
            for (int i = 0; i < half_group; ++i)
                partial[i] += partial[i + half_group];
        const ACC4 total = (ACC)scale * partial[0];
        const REAL4 radiance = (REAL4)(TO_REAL(total.s0), TO_REAL(total.s1), TO_REAL(total.s2), (REAL)0);
        dst[item] = add ? dst[item] + radiance : radiance;
    }
}

// Plain twin: one work-item a chosen point, one leaf after another. Launch: n_chosen work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void shade_cut_plain(const global int *restrict ints, const global REAL *restrict reals,
                     const global REAL *restrict tables, const global int *restrict material,
                     const global REAL4 *restrict leaves, const global int *restrict squares, const int n_leaves,
                     const global int *restrict starts,
                     const global uint *restrict sums, const global int *restrict chosen,
                     const global REAL4 *restrict views, global REAL4 *restrict dst, const REAL scale,
                     const int n_chosen)
{
    const int item = (int)get_global_id(0);
    if (item >= n_chosen)
        return;
    const int point = chosen[item], own = material[point];
    int turn;
    const REAL4 view = canonical(views[item], &turn);
    const int bin = own * (BINS + 1) + bin_of(view);
    ACC4 sum = (ACC4)((ACC)0);
    for (int k = starts[bin]; k < starts[bin + 1] && view.z > (REAL)0; ++k) {
        const float4 mean = unpack_rgb(sums[(size_t)point * N_NODES + squares[(size_t)turn * n_leaves + k]]);
        const REAL4 f = leaves[k].w * brdf(ints + own * MATERIAL_INTS, reals + own * MATERIAL_REALS, tables,
                                           leaves[k], view);
        sum += (ACC4)((ACC)f.x * (ACC)mean.x, (ACC)f.y * (ACC)mean.y, (ACC)f.z * (ACC)mean.z, (ACC)0);
    }
    sum *= (ACC)scale;
    dst[item] = (REAL4)(TO_REAL(sum.s0), TO_REAL(sum.s1), TO_REAL(sum.s2), (REAL)0);
}

// Local views of chosen points from an eye: `positions` and `frames` of the mesh's points, 3 and 9 REALs each.
// Launch: n_chosen work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void local_views(const global REAL *restrict positions, const global REAL *restrict frames,
                 const global int *restrict chosen, const REAL eye_x, const REAL eye_y, const REAL eye_z,
                 global REAL4 *restrict views, const int n_chosen)
{
    const int item = (int)get_global_id(0);
    if (item >= n_chosen)
        return;
    const int point = chosen[item];
    const global REAL *p = positions + 3 * (size_t)point, *f = frames + 9 * (size_t)point;
    REAL x = eye_x - p[0], y = eye_y - p[1], z = eye_z - p[2];
    // Scaled first: squares of large or small differences leave float32.
    const REAL most = fmax(fmax(fabs(x), fabs(y)), fabs(z));
    if (most > (REAL)0) {
        x /= most;
        y /= most;
        z /= most;
    }
    const REAL a = x * f[0] + y * f[1] + z * f[2], b = x * f[3] + y * f[4] + z * f[5];
    const REAL c = x * f[6] + y * f[7] + z * f[8];
    const REAL length = sqrt(a * a + b * b + c * c);
    views[item] = (length > (REAL)0) ? (REAL4)(a / length, b / length, c / length, (REAL)0) : (REAL4)((REAL)0);
}
