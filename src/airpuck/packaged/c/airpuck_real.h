/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* Number type of the exported C: double, or float where AIRPUCK_SINGLE is defined.
 *
 * Constants are written AIRPUCK_R(0.5) and functions of <math.h> AIRPUCK_F(sin), so that no double
 * appears in a single-precision build. */
#ifndef AIRPUCK_REAL_H
#define AIRPUCK_REAL_H

#include <math.h>

/* Poses may be infinite or NaN. These options would remove the checks that reject them. */
#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || \
    (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math and -ffinite-math-only: they remove checks of the input"
#endif

#ifdef AIRPUCK_SINGLE
typedef float airpuck_real;
#define AIRPUCK_R(number) number##f
#define AIRPUCK_F(function) function##f
#else
typedef double airpuck_real;
#define AIRPUCK_R(number) number
#define AIRPUCK_F(function) function
#endif

#endif
