// SPDX-License-Identifier: MIT
// Transport times light: the radiance of pixels under many environments at once.
//
//     I[p, c, e] = sum over k of T[c or 0, p, k] L[c, cells[k], e]
//
//   transport   CHANNELS planes of n_pixels rows of n_cells REALs (pixel_transport.cl)
//   lights      3 n_panels panels of `all` rows of PANEL REALs: an environment a column, red's panels first
//   cells       n_cells ints: which of the `all` rows the transport's columns stand for
//   dst         n_pixels rows of 3 n_panels PANEL REALs
//   launch      3 n_panels PANEL work-items in x, one a column; blocks of ROWS pixels in y
//   work        2 n_cells ROWS flops a work-item
//   rounding    n_cells terms in order: |error| <= n_cells u sum |term|; a column's bytes do not depend on the others

#include "common.clh"

// Problem constants
#ifndef CHANNELS
  #error "CHANNELS: pass -D CHANNELS=1 or 3"
#endif
#ifndef PANEL
  #error "PANEL: pass -D PANEL=<environments a panel>"
#endif

// Tunables
#ifndef ROWS
  #define ROWS 8        // pixels a work-item
#endif
#ifndef GROUP
  #define GROUP 16      // work-items a group
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pixel_product(const global REAL *restrict transport, const global REAL *restrict lights, const int all,
                   const global int *restrict cells, const int n_cells, const int n_pixels, const int n_panels,
                   global REAL *restrict dst)
{
    const int column = (int)get_global_id(0), columns = 3 * n_panels * PANEL;
    const int row = (int)get_global_id(1) * ROWS;
    if (column >= columns)
        return;
    const int channel = (CHANNELS == 3) ? column / (n_panels * PANEL) : 0;
    const global REAL *light = lights + (size_t)(column / PANEL) * all * PANEL + column % PANEL;
    const global REAL *own[ROWS];
    ACC sum[ROWS];
    for (int r = 0; r < ROWS; ++r) {
        // Rows beyond the last are the last once more, and are not written.
        own[r] = transport + ((size_t)channel * n_pixels + min(row + r, n_pixels - 1)) * n_cells;
        sum[r] = (ACC)0;
    }
    for (int k = 0; k < n_cells; ++k) {
        const ACC value = light[(size_t)cells[k] * PANEL];
        for (int r = 0; r < ROWS; ++r)
            sum[r] = fma((ACC)own[r][k], value, sum[r]);
    }
    for (int r = 0; r < ROWS; ++r)
        if (row + r < n_pixels)
            dst[(size_t)(row + r) * columns + column] = TO_REAL(sum[r]);
}

// The same from the definition: one work-item a column of one pixel, pixels in y.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void pixel_product_plain(const global REAL *restrict transport, const global REAL *restrict lights, const int all,
                         const global int *restrict cells, const int n_cells, const int n_pixels, const int n_panels,
                         global REAL *restrict dst)
{
    const int column = (int)get_global_id(0), columns = 3 * n_panels * PANEL;
    const size_t pixel = get_global_id(1);
    if (column >= columns)
        return;
    const int channel = (CHANNELS == 3) ? column / (n_panels * PANEL) : 0;
    ACC sum = (ACC)0;
    for (int k = 0; k < n_cells; ++k)
        sum = fma((ACC)transport[((size_t)channel * n_pixels + pixel) * n_cells + k],
                  (ACC)lights[((size_t)(column / PANEL) * all + cells[k]) * PANEL + column % PANEL], sum);
    dst[pixel * columns + column] = TO_REAL(sum);
}
