/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* DAQP (copyright (c) 2022 Daniel Arnstrom, MIT licence in daqp/LICENSE), in the precision of
 * airpuck_real. Its sources are unchanged, so its warnings are ignored. */
#include "airpuck_qp.h"

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#pragma GCC diagnostic ignored "-Wfloat-conversion"
#pragma GCC diagnostic ignored "-Wdouble-promotion"
#endif

#include "daqp/auxiliary.c"
#include "daqp/daqp.c"
#include "daqp/factorization.c"
