// SPDX-License-Identifier: MIT
// pixel_product for CPUs: a panel of sixteen environments is one vector, ROWS pixels' sums stay in registers.
//
//   launch      3 n_panels work-items in x, one a panel, in groups of one; blocks of ROWS pixels in y
//   work        2 n_cells 16 ROWS flops a work-item; a panel (64 n_cells bytes) stays in the core's cache
//   all else as in pixel_product.cl with PANEL 16; the sums are the same, bit for bit

#include "common.clh"
#include "wide.clh"

// Problem constants
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif

// Tunables
#ifndef ROWS
  #define ROWS 8        // pixels a work-item
#endif

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void pixel_product_wide(const global REAL *restrict transport, const global REAL *restrict lights, const int all,
                        const global int *restrict cells, const int n_cells, const int n_pixels, const int n_panels,
                        global REAL *restrict dst)
{
    const int panel = (int)get_global_id(0), row = (int)get_global_id(1) * ROWS;
    const int channel = (CHANNELS == 3) ? panel / n_panels : 0;
    const global REAL16 *light = (const global REAL16 *)(lights + (size_t)panel * all * 16);
    const global REAL *own[ROWS];
    ACC16 sum[ROWS];
    for (int r = 0; r < ROWS; ++r) {
        own[r] = transport + ((size_t)channel * n_pixels + min(row + r, n_pixels - 1)) * n_cells;
        sum[r] = (ACC16)((ACC)0);
    }
    for (int k = 0; k < n_cells; ++k) {
        const ACC16 value = TO_ACC16(light[cells[k]]);
        for (int r = 0; r < ROWS; ++r)
            sum[r] = fma((ACC16)((ACC)own[r][k]), value, sum[r]);
    }
    for (int r = 0; r < ROWS; ++r)
        if (row + r < n_pixels)
            *((global REAL16 *)(dst + ((size_t)(row + r) * n_panels * 3 + panel) * 16)) = TO_REAL16(sum[r]);
}
