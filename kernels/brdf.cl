// SPDX-License-Identifier: MIT
// BRDF slices f_v = W_v f: reflectance times cosine for one outgoing direction, averaged over the cells of the
// hemisphere. haar.cl turns the rows into coefficients.
//
// Source: equation (1) of Sitthi-Amorn, Romeiro, Zickler, Lawrence: f_v(omega) (n.omega). For a bivariate table W_v
// is linear: each sample is a fixed weighted sum of four table entries.
//
//   ints, reals, tables   materials (brdf.clh)
//   material              the one of this launch
//   directions            4^(LEVELS+SUB) REAL4 of the local frame in Morton order, 4^SUB a cell; w is the mean cosine
//   views                 n_views REAL4, outgoing directions in the local frame
//   dst                   rows of 4^LEVELS REALs, CHANNELS a slice; the launch writes slices first, first + 1, ...
//   launch                4^LEVELS work-items in x, views in y
//   work                  about 80 flops an evaluation (GGX), 4^SUB evaluations a work-item

#include "common.clh"
#include "quadtree.clh"
#include "brdf.clh"
#include "cell.clh"

// Problem constants
#ifndef LEVELS
  #error "LEVELS: pass -D LEVELS=<levels of the slices>"
#endif
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64      // work-items a group
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void brdf_slices(const global int *restrict ints, const global REAL *restrict reals,
                 const global REAL *restrict tables, const int material, const global REAL4 *restrict directions,
                 const global REAL4 *restrict views, global REAL *restrict dst, const int first)
{
    const int cell = (int)get_global_id(0);
    const size_t view = get_global_id(1);
    if (cell >= N_SAMPLES(LEVELS))
        return;
    const REAL4 sum = cell_average(ints + material * MATERIAL_INTS, reals + material * MATERIAL_REALS, tables,
                                   directions + (size_t)cell * N_SAMPLES(SUB), views[view]);
    global REAL *out = dst + (first + view) * CHANNELS * N_SAMPLES(LEVELS) + cell;
    out[0] = sum.x;
    if (CHANNELS == 3) {
        out[N_SAMPLES(LEVELS)] = sum.y;
        out[2 * N_SAMPLES(LEVELS)] = sum.z;
    }
}

// f alone, pair by pair, for scripts and tests. `incident` and `outgoing` n_pairs REAL4, dst n_pairs REAL4.
// Launch: n_pairs work-items in x.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void brdf_evaluate(const global int *restrict ints, const global REAL *restrict reals,
                   const global REAL *restrict tables, const int material, const global REAL4 *restrict incident,
                   const global REAL4 *restrict outgoing, global REAL4 *restrict dst, const int n_pairs)
{
    const size_t pair = get_global_id(0);
    if (pair >= (size_t)n_pairs)
        return;
    dst[pair] = brdf(ints + material * MATERIAL_INTS, reals + material * MATERIAL_REALS, tables, incident[pair],
                     outgoing[pair]);
}
