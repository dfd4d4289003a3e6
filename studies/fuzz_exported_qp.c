/* Quadratic programs of random bits for the exported solver, for libFuzzer.
 *
 *     clang -g -O1 -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all \
 *         -Isrc/airpuck/packaged/c studies/fuzz_exported_qp.c \
 *         src/airpuck/packaged/c/airpuck_qp.c -lm -o out/fuzz_qp
 *     out/fuzz_qp -max_total_time=600
 *
 * Add -DAIRPUCK_SINGLE for single precision. Memory has exactly the stated size. A solution must be
 * finite and within the bounds of its variables, up to rounding; the solver must end. */
#include "airpuck_qp.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef AIRPUCK_SINGLE
#define ROUNDING 1e-3
#else
#define ROUNDING 1e-6
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Read a number: a small integer, which makes degenerate programs, or raw bits. */
static airpuck_real number(const uint8_t **data, size_t *size)
{
    airpuck_real result = 0;
    if (*size >= 1 && (*data)[0] < 240) {
        result = (airpuck_real)((*data)[0] % 9) - 4;
        *data += 1;
        *size -= 1;
    } else if (*size > sizeof result) {
        memcpy(&result, *data + 1, sizeof result);
        *data += 1 + sizeof result;
        *size -= 1 + sizeof result;
    } else {
        *size = 0;
    }
    return result;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 5)
        return 0;
    int n = data[0] % 6 + 1, r = data[1] % 7, s = r > 0 ? data[2] % (r + 1) : 0, m = n + r;
    int definite = data[3] < 200;
    data += 4;
    size -= 4;
    airpuck_qp qp;
    airpuck_real *numbers = malloc(sizeof *numbers * (size_t)AIRPUCK_QP_NUMBERS(n, r, s));
    int *working = malloc(sizeof *working * (size_t)AIRPUCK_QP_ACTIVE(n, s));
    signed char *state = malloc((size_t)m);
    airpuck_real lower[6], upper[6];
    airpuck_qp_begin(&qp, n, r, s, numbers, working, state);
    qp.iteration_limit = 300;
    qp.penalty = AIRPUCK_F(fabs)(number(&data, &size)) + AIRPUCK_R(0.1);
    for (int i = 0; i < n * (n + 1) / 2; i++)
        qp.hessian[i] = number(&data, &size);
    for (int i = 0; i < n && definite; i++) {
        /* Dominant on the diagonal. */
        qp.hessian[airpuck_qp_row(n, i)] = AIRPUCK_F(fabs)(number(&data, &size)) + 25;
    }
    for (int i = 0; i < n; i++)
        qp.gradient[i] = number(&data, &size);
    for (int i = 0; i < r * n; i++)
        qp.matrix[i] = number(&data, &size);
    for (int i = 0; i < m; i++) {
        state[i] = size > 0 ? (signed char)(*data % 11 - 5) : 0;
        data += size > 0;
        size -= size > 0;
        qp.lower[i] = number(&data, &size);
        qp.upper[i] = number(&data, &size);
        if (i < n) {
            lower[i] = qp.lower[i];
            upper[i] = qp.upper[i];
        }
    }
    /* Huge numbers, or a tiny Hessian, leave no digits to check. */
    int plausible = definite && qp.penalty < 100, count = (int)(qp.scale - qp.hessian);
    for (int i = 0; i < count; i++)
        plausible &= fabs((double)qp.hessian[i]) < 100;
    for (int i = 0; i < n; i++)
        plausible &= fabs((double)qp.gradient[i]) < 100;
    airpuck_qp_status status = airpuck_qp_solve(&qp);
    if (status == AIRPUCK_QP_SOLVED || status == AIRPUCK_QP_SOFTENED) {
        double largest = 1;
        for (int i = 0; i < n; i++) {
            if (!isfinite(qp.x[i]))
                abort();
            largest = fabs((double)qp.x[i]) > largest ? fabs((double)qp.x[i]) : largest;
        }
        for (int i = 0; i < n && plausible; i++)
            if ((double)qp.x[i] < (double)lower[i] - ROUNDING * largest ||
                (double)qp.x[i] > (double)upper[i] + ROUNDING * largest)
                abort();
    }
    free(numbers);
    free(working);
    free(state);
    return 0;
}
