#include "airpuck_laws.h"

#define N AIRPUCK_MOTORS
#define PI AIRPUCK_R(3.14159265358979323846)
/* A request counts as met if both slacks are this close to 1. */
#define UNSCALED AIRPUCK_R(1e-6)
#ifdef AIRPUCK_SINGLE
#define RESOLVED AIRPUCK_R(2e-7)
#else
/* Change of a motor speed at which the inverse of its thrust curve has converged. */
#define RESOLVED AIRPUCK_R(1e-12)
#endif
/* Newton's method needs about five iterations, bisection alone 40: this bound is never reached. */
#define MOST_PASSES 100

/* The quadratic program of the allocation; see airpuck_lqr. */
typedef struct {
    airpuck_real rows[3][AIRPUCK_ALLOCATED];
    airpuck_real wanted[3];
    airpuck_real lower[AIRPUCK_ALLOCATED], upper[AIRPUCK_ALLOCATED];
} allocation;

airpuck_real airpuck_wrapped(airpuck_real angle)
{
    return angle - 2 * PI * AIRPUCK_F(rint)(angle * (AIRPUCK_R(0.5) / PI));
}

airpuck_real airpuck_clipped(airpuck_real number, airpuck_real least, airpuck_real most)
{
    if (number < least)
        return least;
    return number > most ? most : number;
}

int airpuck_finite(const airpuck_real *numbers, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(numbers[i]))
            return 0;
    return 1;
}

void airpuck_acceleration_map(airpuck_real yaw, airpuck_real spin, airpuck_real matrix[3][N],
                              airpuck_real offset[3])
{
    const airpuck_model *model = &airpuck_identified;
    airpuck_real cosine = AIRPUCK_F(cos)(yaw), sine = AIRPUCK_F(sin)(yaw), rx, ry;
    airpuck_center_of_mass(model, cosine, sine, &rx, &ry);
    for (int i = 0; i < N; i++) {
        airpuck_real forward = model->configuration[0][i], left = model->configuration[1][i];
        airpuck_real angular = model->configuration[2][i];
        matrix[0][i] = cosine * forward - sine * left + ry * angular;
        matrix[1][i] = sine * forward + cosine * left - rx * angular;
        matrix[2][i] = angular;
    }
    offset[0] = rx * (spin * spin);
    offset[1] = ry * (spin * spin);
    offset[2] = 0;
}

/* The state one period later. Until then the motor speeds fix the accelerations. */
static void look_ahead(const airpuck *craft, airpuck_real following[6])
{
    airpuck_real matrix[3][N], offset[3], force[N], h = airpuck_tuned.period;
    airpuck_acceleration_map(craft->state[2], craft->state[5], matrix, offset);
    airpuck_thrust(&airpuck_identified, craft->motor_speed, force);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real settled = offset[axis] + craft->disturbance[axis];
        for (int i = 0; i < N; i++)
            settled += matrix[axis][i] * force[i];
        following[axis] = craft->state[axis] + h * craft->state[3 + axis] + h * h / 2 * settled;
        following[3 + axis] = craft->state[3 + axis] + h * settled;
    }
}

/* Request the acceleration a_ref - K (x - x_ref), without the disturbance. */
static void request(airpuck *craft, const airpuck_real following[6], const airpuck_target *target)
{
    airpuck_real error[6];
    for (int i = 0; i < 6; i++)
        error[i] = following[i] - target->state[i];
    error[2] = airpuck_wrapped(error[2]);
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real fed_back = 0;
        for (int i = 0; i < 6; i++)
            fed_back += airpuck_tuned.gain[axis][i] * error[i];
        craft->request[axis] = target->acceleration[axis] - fed_back - craft->disturbance[axis];
    }
}

void airpuck_thrust_range(const airpuck *craft, airpuck_real coasting[N], airpuck_real least[N],
                          airpuck_real most[N])
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    for (int i = 0; i < N; i++) {
        coasting[i] = tuning->motor_lag * craft->motor_speed[i];
        least[i] = coasting[i] + tuning->motor_drive * tuning->command_min;
        most[i] = coasting[i] + tuning->motor_drive * tuning->command_max;
    }
    airpuck_thrust(&airpuck_identified, least, least);
    airpuck_thrust(&airpuck_identified, most, most);
}

/* Write the program: thrusts F and scaled slacks root (1 - s) that give the request,
 *
 *     min |F|^2 + root^2 (1 - s1)^2 + root^2 (1 - s2)^2
 *     such that (s1 vx, s1 vy, s2 v_yaw) = M F + g, lower <= F <= upper, 0 <= s1, s2 <= 1.
 *
 * The scale of the slacks makes the Hessian a multiple of the identity. Return whether all its
 * numbers are finite. */
static int pose_problem(const airpuck *craft, const airpuck_real following[6],
                        airpuck_real coasting[N], allocation *posed)
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real matrix[3][N], offset[3];
    airpuck_acceleration_map(following[2], following[5], matrix, offset);
    airpuck_thrust_range(craft, coasting, posed->lower, posed->upper);
    for (int s = 0; s < 2; s++) {
        posed->lower[N + s] = 0;
        posed->upper[N + s] = tuning->slack_root;
    }
    for (int axis = 0; axis < 3; axis++) {
        airpuck_real scale = axis == 2 ? tuning->arm : 1, asked = scale * craft->request[axis];
        for (int i = 0; i < N; i++)
            posed->rows[axis][i] = scale * matrix[axis][i];
        posed->rows[axis][N] = axis == 2 ? 0 : asked / tuning->slack_root;
        posed->rows[axis][N + 1] = axis == 2 ? asked / tuning->slack_root : 0;
        posed->wanted[axis] = asked - scale * offset[axis];
    }
    return airpuck_finite(posed->rows[0], 3 * AIRPUCK_ALLOCATED) &&
           airpuck_finite(posed->wanted, 3) && airpuck_finite(posed->lower, AIRPUCK_ALLOCATED) &&
           airpuck_finite(posed->upper, AIRPUCK_ALLOCATED);
}

/* Minimise x'x over n variables with rows * x = wanted and x within bounds; return whether that is
 * feasible. `price` is the derivative of the minimum with respect to `wanted`. */
static int solve_least(airpuck *craft, int n, airpuck_real *rows, const airpuck_real wanted[3],
                       const airpuck_real *lower, const airpuck_real *upper, airpuck_real *x,
                       airpuck_real price[3])
{
    airpuck_qp qp;
    int sense[AIRPUCK_ALLOCATED + 3];
    airpuck_qp_begin(&qp, n, 3, 0, rows, craft->numbers, craft->active, sense);
#ifdef AIRPUCK_SINGLE
    qp.settings.primal_tol = AIRPUCK_R(2e-6);
#else
    /* With its default tolerances, DAQP calls small requests with nearly parallel columns
     * infeasible, and misses others slightly. */
    qp.settings.sing_tol = AIRPUCK_R(1e-14);
    qp.settings.primal_tol = AIRPUCK_R(1e-9);
#endif
    for (int i = 0; i < n + 3; i++) {
        int equality = i >= n;
        sense[i] = equality ? DAQP_ACTIVE | DAQP_IMMUTABLE : 0;
        qp.lower[i] = equality ? wanted[i - n] : lower[i];
        qp.upper[i] = equality ? wanted[i - n] : upper[i];
    }
    airpuck_qp_factor_twice_identity(&qp);
    int flag = airpuck_qp_solve(&qp);
    craft->iterations += qp.work.iterations;
    for (int i = 0; i < n; i++)
        x[i] = qp.work.x[i];
    for (int i = 0; i < qp.work.n_active; i++)
        if (qp.work.WS[i] >= n)
            price[qp.work.WS[i] - n] = -qp.work.lam_star[i];
    return flag == DAQP_EXIT_OPTIMAL;
}

#ifndef AIRPUCK_SINGLE

/* Solve the program; return whether it is feasible. */
static int solve_constrained(airpuck *craft, allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    airpuck_real price[3];
    return solve_least(craft, AIRPUCK_ALLOCATED, posed->rows[0], posed->wanted, posed->lower,
                       posed->upper, x, price);
}

#else

/* A float cannot resolve the cost of thrusts beside that of slacks, a million times as large. In
 * single precision the program is therefore solved in two parts: first without scaling the request,
 * which gives the thrusts of an exact solution; if that is infeasible, with the least scaling. In
 * the second part the thrusts are almost unique. So their cost may be that of leaving the previous
 * pass's solution. */
#define PASSES 12

/* Return the unit of thrust changes. In this unit, changes that are small compared with the request
 * cost as little as scaling it. */
static airpuck_real thrust_unit(const allocation *posed)
{
    airpuck_real column = 0, asked = 0;
    for (int i = 0; i < AIRPUCK_ALLOCATED; i++) {
        airpuck_real square = 0;
        for (int axis = 0; axis < 3; axis++)
            square += posed->rows[axis][i] * posed->rows[axis][i];
        if (i < N)
            column = square > column ? square : column;
        else
            asked = square > asked ? square : asked;
    }
    return 20 * airpuck_tuned.slack_root * AIRPUCK_F(sqrt)(asked / column);
}

static int solve_exact(airpuck *craft, const allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    airpuck_real rows[3][N], price[3] = {0};
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < N; i++)
            rows[axis][i] = posed->rows[axis][i];
    if (!solve_least(craft, N, rows[0], posed->wanted, posed->lower, posed->upper, x, price))
        return 0;
    /* Scaling the request slightly saves thrust: the slack at which cost and saving balance. */
    for (int slack = N; slack < AIRPUCK_ALLOCATED; slack++) {
        airpuck_real saved = 0;
        for (int axis = 0; axis < 3; axis++)
            saved += price[axis] * posed->rows[axis][slack];
        x[slack] = saved > 0 ? saved / 2 : 0;
    }
    return 1;
}

static int solve_constrained(airpuck *craft, allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    if (solve_exact(craft, posed, x))
        return 1;
    airpuck_real force[N] = {0}, unit = thrust_unit(posed), root = airpuck_tuned.slack_root;
    for (int pass = 0; pass < PASSES; pass++) {
        airpuck_real rows[3][AIRPUCK_ALLOCATED], wanted[3], price[3];
        airpuck_real lower[AIRPUCK_ALLOCATED], upper[AIRPUCK_ALLOCATED];
        for (int j = 0; j < AIRPUCK_ALLOCATED; j++) {
            lower[j] = j < N ? (posed->lower[j] - force[j]) / unit : 0;
            upper[j] = j < N ? (posed->upper[j] - force[j]) / unit : 1;
            for (int axis = 0; axis < 3; axis++)
                rows[axis][j] = posed->rows[axis][j] * (j < N ? unit : root);
        }
        for (int axis = 0; axis < 3; axis++) {
            wanted[axis] = posed->wanted[axis];
            for (int i = 0; i < N; i++)
                wanted[axis] -= posed->rows[axis][i] * force[i];
        }
        if (!solve_least(craft, AIRPUCK_ALLOCATED, rows[0], wanted, lower, upper, x, price))
            return pass > 0 && airpuck_finite(x, AIRPUCK_ALLOCATED);
        for (int i = 0; i < N; i++)
            x[i] = force[i] =
                airpuck_clipped(force[i] + unit * x[i], posed->lower[i], posed->upper[i]);
        for (int slack = N; slack < AIRPUCK_ALLOCATED; slack++)
            x[slack] *= root;
    }
    return 1;
}

#endif

/* Find the acceleration nearest to a scaled request: min |Ax - b|^2 + (small weights) x^2 over
 * thrusts and slacks 1 - s within their bounds. Return whether it was found. */
static int solve_nearest(airpuck *craft, const allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
#ifdef AIRPUCK_SINGLE
    /* A float cannot resolve the small weights next to A'A. Larger weights on the distance from the
     * previous solution give nearly the same result. */
    const airpuck_real weights[2] = {AIRPUCK_R(1e-3), AIRPUCK_R(1e-2)};
    const int passes = 4;
#else
    const airpuck_real weights[2] = {AIRPUCK_R(1e-8), AIRPUCK_R(1e-7)};
    const int passes = 1;
#endif
    int n = AIRPUCK_ALLOCATED;
    for (int i = 0; i < n; i++)
        x[i] = 0;
    for (int pass = 0; pass < passes; pass++) {
        airpuck_qp qp;
        int sense[AIRPUCK_ALLOCATED] = {0};
        airpuck_qp_begin(&qp, n, 0, 0, NULL, craft->numbers, craft->active, sense);
        airpuck_real a[3][AIRPUCK_ALLOCATED];
        for (int j = 0; j < n; j++) {
            airpuck_real unit = j < N ? 1 : airpuck_tuned.slack_root, weight = weights[j >= N];
            for (int axis = 0; axis < 3; axis++)
                a[axis][j] = posed->rows[axis][j] * unit;
            qp.lower[j] = posed->lower[j] / unit;
            qp.upper[j] = posed->upper[j] / unit;
            qp.gradient[j] = -weight * x[j];
            for (int axis = 0; axis < 3; axis++)
                qp.gradient[j] -= posed->wanted[axis] * a[axis][j];
        }
        for (int i = 0, at = 0; i < n; i++)
            for (int j = i; j < n; j++, at++) {
                qp.hessian[at] = i == j ? weights[j >= N] : 0;
                for (int axis = 0; axis < 3; axis++)
                    qp.hessian[at] += a[axis][i] * a[axis][j];
            }
        if (!airpuck_qp_factor(&qp))
            return 0;
        if (!airpuck_qp_unconstrained(&qp)) {
            int flag = airpuck_qp_solve(&qp);
            craft->iterations += qp.work.iterations;
            if (flag != DAQP_EXIT_OPTIMAL)
                return 0;
        }
        for (int i = 0; i < n; i++)
            x[i] = qp.work.x[i];
    }
    for (int s = N; s < n; s++)
        x[s] *= airpuck_tuned.slack_root;
    return 1;
}

static airpuck_status allocate(airpuck *craft, allocation *posed, airpuck_real x[AIRPUCK_ALLOCATED])
{
    if (!solve_constrained(craft, posed, x)) {
        int found = solve_nearest(craft, posed, x) && airpuck_finite(x, AIRPUCK_ALLOCATED);
        return found ? AIRPUCK_NEAREST : AIRPUCK_FAILED;
    }
    if (!airpuck_finite(x, AIRPUCK_ALLOCATED))
        return AIRPUCK_FAILED;
    airpuck_real slack = (x[N] > x[N + 1] ? x[N] : x[N + 1]) / airpuck_tuned.slack_root;
    return 1 - slack > 1 - UNSCALED ? AIRPUCK_EXACT : AIRPUCK_SCALED;
}

/* Return the thrust of one motor; set the slope of its curve. */
static airpuck_real curve(int motor, airpuck_real speed, airpuck_real *slope)
{
    const airpuck_real *coefficients = airpuck_identified.thrust[motor];
    airpuck_real total = 0;
    *slope = 0;
    for (int power = AIRPUCK_DEGREE - 1; power >= 0; power--) {
        total = (total + coefficients[power]) * speed;
        *slope = *slope * speed + (airpuck_real)(power + 1) * coefficients[power];
    }
    return total;
}

/* Return the motor speed that gives a thrust, by Newton's method with bisection as safeguard. */
static airpuck_real inverse_thrust(int motor, airpuck_real force)
{
    airpuck_real slope, top = curve(motor, 1, &slope);
    airpuck_real target = airpuck_clipped(force, 0, top), low = 0, high = 1;
    airpuck_real speed = top > 0 ? target / top : 0;
    for (int pass = 0; pass < MOST_PASSES; pass++) {
        airpuck_real error = curve(motor, speed, &slope) - target;
        if (error <= 0)
            low = speed;
        if (error >= 0)
            high = speed;
        if (error == 0)
            break;
        airpuck_real newton = speed - error / slope;
        airpuck_real following = newton > low && newton < high ? newton : (low + high) / 2;
        airpuck_real change = AIRPUCK_F(fabs)(following - speed);
        speed = following;
        if (!(change > RESOLVED))
            break;
    }
    return speed;
}

airpuck_real airpuck_driven(int motor, airpuck_real force, airpuck_real coasting)
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real driven = (inverse_thrust(motor, force) - coasting) / tuning->motor_drive;
    return airpuck_clipped(driven, tuning->command_min, tuning->command_max);
}

airpuck_status airpuck_lqr(airpuck *craft, const airpuck_target *target,
                           airpuck_real command[AIRPUCK_MOTORS])
{
    const airpuck_tuning *tuning = &airpuck_tuned;
    airpuck_real following[6], coasting[N], x[AIRPUCK_ALLOCATED];
    allocation posed;
    look_ahead(craft, following);
    request(craft, following, target);
    airpuck_status status = AIRPUCK_FAILED;
    if (pose_problem(craft, following, coasting, &posed))
        status = allocate(craft, &posed, x);
    if (status != AIRPUCK_FAILED) {
        for (int i = 0; i < N; i++) {
            /* The solver meets bounds to its tolerance; the result meets them exactly. */
            airpuck_real force = airpuck_clipped(x[i], posed.lower[i], posed.upper[i]);
            command[i] = airpuck_driven(i, force, coasting[i]);
        }
        if (airpuck_finite(command, N))
            return status;
    }
    for (int i = 0; i < N; i++)
        command[i] = tuning->command_min;
    return AIRPUCK_FAILED;
}
