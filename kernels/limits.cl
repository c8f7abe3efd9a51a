// SPDX-License-Identifier: MIT
// The device's own limits, which every stage is held against: bytes copied and multiply-adds done a second.
//
// Which form of a copy is fastest depends on the device: a GPU wants neighbouring work-items at neighbouring addresses
// (`copy_items`), a CPU long runs of vectors (`copy_rows`), and stores that go past its caches where the compiler has
// them (`copy_rows_stream`; without them the same as `copy_rows`). The limit is the fastest of the three.
//
//   copy_items         one REAL4 a work-item, n of them in groups of GROUP
//   copy_rows          ROW REALs a work-item in vectors of sixteen, n rows in groups of one
//   copy_rows_stream   the same
//   work               every REAL of src read once, every REAL of dst written once; n is bounded for the last group
//
//   multiply_adds      ACCUMULATORS independent chains of REAL16, `iterations` long, a work-item in groups of GROUP
//   work               2 * 16 * ACCUMULATORS * iterations flops a work-item, one REAL stored

#include "common.clh"
#include "wide.clh"

// Problem constants
#ifndef ROW
  #error "ROW: pass -D ROW=<REALs that a work-item of copy_rows copies, a multiple of 16>"
#endif

// Tunables
#ifndef GROUP
  #define GROUP 64          // work-items a group
#endif
#ifndef ACCUMULATORS
  #define ACCUMULATORS 8    // enough to hide a multiply-add's latency, few enough for the registers
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void copy_items(const global REAL4 *restrict src, global REAL4 *restrict dst, const int n)
{
    const size_t item = get_global_id(0);
    if (item < (size_t)n)
        dst[item] = src[item];
}

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void copy_rows(const global REAL16 *restrict src, global REAL16 *restrict dst, const int n)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n)
        return;
    for (size_t i = row * (ROW / 16); i < (row + 1) * (ROW / 16); ++i)
        dst[i] = src[i];
}

kernel __attribute__((reqd_work_group_size(1, 1, 1)))
void copy_rows_stream(const global REAL16 *restrict src, global REAL16 *restrict dst, const int n)
{
    const size_t row = get_global_id(0);
    if (row >= (size_t)n)
        return;
    for (size_t i = row * (ROW / 16); i < (row + 1) * (ROW / 16); ++i)
        STREAM(src[i], dst + i);
}

// x <- factor x + offset over and over: neither is known to the compiler, and the sum of all chains is stored.
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void multiply_adds(global REAL *restrict dst, const REAL factor, const REAL offset, const int iterations)
{
    const size_t item = get_global_id(0);
    const REAL16 f = (REAL16)(factor), o = (REAL16)(offset);
    REAL16 x[ACCUMULATORS];
#pragma unroll
    for (int k = 0; k < ACCUMULATORS; ++k)
        x[k] = (REAL16)((REAL)((int)(item & 63) + k));
    for (int i = 0; i < iterations; ++i) {
#pragma unroll
        for (int k = 0; k < ACCUMULATORS; ++k)
            x[k] = fma(x[k], f, o);
    }
    REAL16 sum = x[0];
#pragma unroll
    for (int k = 1; k < ACCUMULATORS; ++k)
        sum += x[k];
    REAL total = (REAL)0;
    total += sum.s0 + sum.s1 + sum.s2 + sum.s3 + sum.s4 + sum.s5 + sum.s6 + sum.s7;
    total += sum.s8 + sum.s9 + sum.sa + sum.sb + sum.sc + sum.sd + sum.se + sum.sf;
    dst[item] = total;
}
