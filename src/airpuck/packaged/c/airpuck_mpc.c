/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_laws.h"
#include "airpuck_slopes.h"

#include <string.h>

#if AIRPUCK_STEPS > 0

enum { MOTORS = AIRPUCK_MOTORS, STATES = AIRPUCK_STATES, COMMANDS = AIRPUCK_COMMANDS };

#define FULL_TURN AIRPUCK_R(6.28318530717958647693)
/* Below this speed, or distance, a direction is undefined [m/s, m]. */
#define NOWHERE AIRPUCK_R(1e-9)

static const airpuck_horizon *const horizon = &airpuck_predicted;

/* One linearised step: the state after it, and how state and accelerations change. */
typedef struct {
    const airpuck_real *state;
    airpuck_real onward[6][AIRPUCK_STEERED];
    airpuck_real by_speed[MOTORS], by_command[MOTORS];
    airpuck_real felt[3][AIRPUCK_MOVING];
    airpuck_real error[6], excess[3]; /* Errors of state and accelerations. */
    airpuck_real weighted[6];         /* The error times its weight. */
} stage;

/* What all steps of a prediction share. */
typedef struct {
    const airpuck *craft;
    const airpuck_target *targets;
    airpuck_real start[STATES];
    airpuck_real whole_turns; /* Between the yaw and the target's. */
    airpuck_real apart;       /* Yaw still to turn. */
    airpuck_real (*states)[STATES], (*bend)[MOTORS], (*moved)[COMMANDS];
} prediction;

static void begin_commands(airpuck_plan *plan)
{
    for (int b = 0; b < AIRPUCK_BLOCKS; b++)
        for (int i = 0; i < MOTORS; i++)
            plan->commands[b][i] = horizon->first;
    plan->since = 0;
    plan->answered = -(double)INFINITY;
    plan->way = 0;
}

void airpuck_plan_begin(airpuck_plan *plan)
{
    begin_commands(plan);
    memset(plan->active, AIRPUCK_QP_INACTIVE, sizeof plan->active);
    memcpy(plan->fence, horizon->fence, sizeof plan->fence);
    memcpy(plan->keep_out, horizon->keep_out, sizeof plan->keep_out);
}

/* Shift a plan in time: the mean of the old commands over each block; the last is held. */
static void shift(airpuck_plan *plan, airpuck_real elapsed)
{
    for (int i = 0; i < MOTORS; i++) {
        airpuck_real edge = 0, means[AIRPUCK_BLOCKS];
        for (int b = 0; b < AIRPUCK_BLOCKS; b++) {
            airpuck_real from = edge + elapsed, to = from + horizon->lasting[b], begins = 0;
            means[b] = 0;
            for (int old = 0; old < AIRPUCK_BLOCKS; old++) {
                airpuck_real ends = begins + horizon->lasting[old];
                airpuck_real low = from > begins ? from : begins;
                airpuck_real high = to < ends || old == AIRPUCK_BLOCKS - 1 ? to : ends;
                if (high > low)
                    means[b] += (high - low) * plan->commands[old][i];
                begins = ends;
            }
            edge += horizon->lasting[b];
        }
        for (int b = 0; b < AIRPUCK_BLOCKS; b++)
            plan->commands[b][i] =
                airpuck_clipped(means[b] / horizon->lasting[b], airpuck_tuned.command_min,
                                airpuck_tuned.command_max);
    }
}

/* Ignore whole turns to the target; near half a turn, keep the chosen direction of rotation. */
static void choose_direction(prediction *p)
{
    airpuck_real left = p->craft->state[2] - p->targets[1].state[2], way = p->craft->plan.way;
    p->apart = airpuck_wrapped(left);
    if (p->apart * way < 0 && AIRPUCK_F(fabs)(way) > horizon->undecided &&
        AIRPUCK_F(fabs)(p->apart) > horizon->undecided)
        p->apart += way > 0 ? FULL_TURN : -FULL_TURN;
    p->whole_turns = left - p->apart;
}

static void predict_states(prediction *p)
{
    airpuck_real h = horizon->step, state[STATES];
    memcpy(state, p->start, sizeof state);
    for (int k = 0; k < AIRPUCK_STEPS; k++) {
        airpuck_model_step(&airpuck_identified, state, p->craft->plan.commands[horizon->owner[k]],
                           h);
        for (int axis = 0; axis < 3; axis++) {
            state[axis] += h * h / 2 * p->craft->disturbance[axis];
            state[3 + axis] += h * p->craft->disturbance[axis];
        }
        memcpy(p->states[k], state, sizeof state);
    }
}

/* Set the derivatives of step k with respect to state and commands. */
static void linearise_step(const prediction *p, int k, stage *at)
{
    const airpuck_real *before = k > 0 ? p->states[k - 1] : p->start;
    airpuck_step_slopes(&airpuck_identified, before, p->craft->plan.commands[horizon->owner[k]],
                        horizon->step, at->onward, at->by_speed, at->by_command);
}

/* Set what follows from the state after step k. */
static void look_at(const prediction *p, int k, stage *at)
{
    const airpuck_target *target = &p->targets[1 + k];
    const airpuck_real *state = at->state = p->states[k];
    airpuck_acceleration_slopes(&airpuck_identified, state + 2, state + 6, at->excess, at->felt);
    for (int axis = 0; axis < 3; axis++)
        at->excess[axis] += p->craft->disturbance[axis] - target->acceleration[axis];
    for (int i = 0; i < 6; i++)
        at->error[i] = state[i] - target->state[i] - (i == 2 ? p->whole_turns : 0);
    for (int i = 0; i < 6; i++) {
        at->weighted[i] = horizon->weights[i] * at->error[i];
        if (k < AIRPUCK_STEPS - 1)
            continue;
        at->weighted[i] = 0;
        for (int j = 0; j < 6; j++)
            at->weighted[i] += horizon->terminal[i][j] * at->error[j];
    }
}

/* Second derivative of a thrust curve. */
static airpuck_real curvature(int motor, airpuck_real speed)
{
    airpuck_real total = 0;
    for (int power = AIRPUCK_DEGREE - 1; power > 0; power--)
        total = total * speed +
                (airpuck_real)(power * (power + 1)) * airpuck_identified.thrust[motor][power];
    return total;
}

/* The convex part of the Hessian that the curvature of the thrust curves adds.
 *
 * At full speed a thrust curve is flat, so slowing a motor down seems to cost nothing; without this
 * term the next plan would slow it down. The costate is the gradient of the cost with respect
 * to the state. */
static void add_curvature(prediction *p)
{
    airpuck_real costate[STATES + 1] = {0}, later[STATES], h = horizon->step;
    stage at;
    for (int k = AIRPUCK_STEPS - 1; k >= 0; k--) {
        airpuck_real before[STATES] = {0}, price[3], pushed[3];
        memcpy(later, costate, sizeof later);
        if (k < AIRPUCK_STEPS - 1) {
            linearise_step(p, k + 1, &at);
            before[0] = later[0];
            before[1] = later[1];
            for (int q = 0; q < AIRPUCK_MOVING; q++)
                for (int i = 0; i < 6; i++)
                    before[2 + q] += at.onward[i][q] * later[i];
            for (int i = 0; i < MOTORS; i++)
                before[6 + i] += at.by_speed[i] * later[6 + i];
        }
        look_at(p, k, &at);
        for (int axis = 0; axis < 3; axis++)
            pushed[axis] = horizon->effort[axis] * at.excess[axis];
        for (int i = 0; i < STATES; i++) {
            costate[i] = before[i] + (i < 6 ? at.weighted[i] : 0);
            for (int axis = 0; axis < 3 && i >= 2; axis++)
                costate[i] += at.felt[axis][i - 2] * pushed[axis];
        }
        /* A motor speed at the end of a step acts for half of that step and half of the next. */
        for (int axis = 0; axis < 3; axis++)
            price[axis] = h / 2 * (costate[3 + axis] + later[3 + axis]) +
                          h * h / 4 * (costate[axis] + later[axis]) + pushed[axis];
        const airpuck_real(*turn)[MOTORS] = airpuck_identified.configuration;
        airpuck_real cosine = AIRPUCK_F(cos)(at.state[2]), sine = AIRPUCK_F(sin)(at.state[2]);
        for (int i = 0; i < MOTORS; i++) {
            airpuck_real by_thrust = price[0] * (cosine * turn[0][i] - sine * turn[1][i]) +
                                     price[1] * (sine * turn[0][i] + cosine * turn[1][i]) +
                                     price[2] * turn[2][i];
            airpuck_real bent = by_thrust * curvature(i, at.state[6 + i]);
            p->bend[k][i] = bent > 0 ? bent : 0;
        }
    }
}

/* Set the direction of a vector; zero if the vector is too short to have one. */
static void direction(airpuck_real x, airpuck_real y, airpuck_real result[2])
{
    airpuck_real length = AIRPUCK_F(sqrt)(x * x + y * y);
    result[0] = length > NOWHERE ? x / length : 0;
    result[1] = length > NOWHERE ? y / length : 0;
}

/* Write the limits of a state as bounds on linear functions of its changes. */
static void limit_state(const prediction *p, const airpuck_real state[6],
                        airpuck_real rows[AIRPUCK_LIMITS][6], airpuck_real lower[AIRPUCK_LIMITS],
                        airpuck_real upper[AIRPUCK_LIMITS])
{
    const airpuck_plan *plan = &p->craft->plan;
    int row = 0;
    memset(rows, 0, sizeof(airpuck_real) * AIRPUCK_LIMITS * 6);
    for (; row < 2; row++) {
        /* For a craft that moves towards the fence, the limit applies where it can still brake. */
        rows[row][row] = 1;
        rows[row][3 + row] =
            horizon->headway + AIRPUCK_F(fabs)(state[3 + row]) / (2 * horizon->brake);
        airpuck_real room = horizon->turning * AIRPUCK_F(fabs)(state[5]);
        airpuck_real half = (plan->fence[1][row] - plan->fence[0][row]) / 2;
        room = room < horizon->most_room ? room : horizon->most_room;
        room = room < half ? room : half;
        lower[row] = plan->fence[0][row] + room;
        upper[row] = plan->fence[1][row] - room;
    }
#if AIRPUCK_LIMITS_SPEED
    direction(state[3], state[4], &rows[row][3]);
    lower[row] = -INFINITY;
    upper[row++] = horizon->speed;
#endif
#if AIRPUCK_LIMITS_SPIN
    rows[row][5] = 1;
    lower[row] = -horizon->spin;
    upper[row++] = horizon->spin;
#endif
    for (int d = 0; d < AIRPUCK_DISCS; d++, row++) {
        const airpuck_real *disc = plan->keep_out[d];
        direction(state[0] - disc[0], state[1] - disc[1], rows[row]);
        lower[row] = rows[row][0] * disc[0] + rows[row][1] * disc[1] + disc[2];
        upper[row] = INFINITY;
    }
    for (row = 0; row < AIRPUCK_LIMITS; row++) {
        airpuck_real now = 0;
        for (int i = 0; i < 6; i++)
            now += rows[row][i] * state[i];
        lower[row] -= now;
        upper[row] -= now;
    }
}

/* Move the changes of the state, one column for each command, through step k. */
static void move_columns(const prediction *p, int k, const stage *at)
{
    int block = horizon->owner[k];
    for (int j = 0; j < (block + 1) * MOTORS; j++) {
        airpuck_real before[STATES];
        int chosen = j - block * MOTORS;
        for (int i = 0; i < STATES; i++)
            before[i] = p->moved[i][j];
        for (int i = 0; i < 6; i++) {
            airpuck_real sum = i < 2 ? before[i] : 0;
            for (int q = 0; q < AIRPUCK_MOVING; q++)
                sum += at->onward[i][q] * before[2 + q];
            p->moved[i][j] = sum + (chosen >= 0 ? at->onward[i][AIRPUCK_MOVING + chosen] : 0);
        }
        for (int i = 0; i < MOTORS; i++)
            p->moved[6 + i][j] =
                at->by_speed[i] * before[6 + i] + (i == chosen ? at->by_command[i] : 0);
    }
}

/* Add the sum of weights[q] * a[q] b[q]' to the upper triangle of the Hessian, for columns before
 * `count`. Three at once, because reading and writing the Hessian takes most of the time. */
static void add_products(airpuck_qp *qp, int count, const airpuck_real weights[3],
                         airpuck_real (*a)[COMMANDS], airpuck_real (*b)[COMMANDS])
{
    for (int i = 0; i < count; i++) {
        airpuck_real *row = qp->hessian + airpuck_qp_row(COMMANDS, i) - i;
        airpuck_real x = weights[0] * a[0][i], y = weights[1] * a[1][i], z = weights[2] * a[2][i];
        for (int j = i; j < count; j++)
            row[j] += x * b[0][j] + y * b[1][j] + z * b[2][j];
    }
}

/* Add weight * a a' for the speed of motor i, which only its own commands change. */
static void add_speed(airpuck_qp *qp, int count, airpuck_real weight, int motor,
                      const airpuck_real a[COMMANDS])
{
    for (int i = motor; i < count && weight != 0; i += MOTORS)
        for (int j = i; j < count; j += MOTORS)
            qp->hessian[airpuck_qp_row(COMMANDS, i) + j - i] += weight * a[i] * a[j];
}

static void add_gradient(airpuck_qp *qp, int count, airpuck_real weight,
                         const airpuck_real a[COMMANDS])
{
    for (int j = 0; j < count; j++)
        qp->gradient[j] += weight * a[j];
}

/* Add the costs after step k. */
static void add_costs(const prediction *p, int k, const stage *at, airpuck_qp *qp)
{
    static const airpuck_real ones[3] = {1, 1, 1};
    int count = (horizon->owner[k] + 1) * MOTORS;
    airpuck_real scaled[3][COMMANDS];
    for (int half = 0; half < 6; half += 3) {
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < count; j++) {
                airpuck_real sum = 0;
                for (int other = 0; other < 6 && k == AIRPUCK_STEPS - 1; other++)
                    sum += horizon->terminal[half + i][other] * p->moved[other][j];
                scaled[i][j] = k < AIRPUCK_STEPS - 1
                                   ? horizon->weights[half + i] * p->moved[half + i][j]
                                   : sum;
            }
            add_gradient(qp, count, at->weighted[half + i], p->moved[half + i]);
        }
        add_products(qp, count, ones, p->moved + half, scaled);
    }
    for (int axis = 0; axis < 3; axis++) {
        for (int j = 0; j < count; j++) {
            scaled[axis][j] = 0;
            for (int q = 0; q < AIRPUCK_MOVING; q++)
                scaled[axis][j] += at->felt[axis][q] * p->moved[2 + q][j];
        }
        add_gradient(qp, count, horizon->effort[axis] * at->excess[axis], scaled[axis]);
    }
    add_products(qp, count, horizon->effort, scaled, scaled);
    for (int i = 0; i < MOTORS; i++)
        add_speed(qp, count, p->bend[k][i], i, p->moved[6 + i]);
}

static void add_limits(const prediction *p, int k, const stage *at, airpuck_qp *qp)
{
    airpuck_real rows[AIRPUCK_LIMITS][6];
    int first = k * AIRPUCK_LIMITS;
    limit_state(p, at->state, rows, qp->lower + COMMANDS + first, qp->upper + COMMANDS + first);
    for (int row = 0; row < AIRPUCK_LIMITS; row++)
        for (int j = 0; j < COMMANDS; j++) {
            airpuck_real *entry = &qp->matrix[(first + row) * COMMANDS + j];
            *entry = 0;
            for (int i = 0; i < 6; i++)
                *entry += rows[row][i] * p->moved[i][j];
        }
}

/* Write the program in the changes of the commands. */
static void form(prediction *p, airpuck_qp *qp)
{
    memset(qp->hessian, 0, sizeof(airpuck_real) * COMMANDS * (COMMANDS + 1) / 2);
    memset(p->moved, 0, sizeof(airpuck_real) * STATES * COMMANDS);
    for (int j = 0; j < COMMANDS; j++) {
        airpuck_real used = horizon->used[j / MOTORS];
        airpuck_real command = p->craft->plan.commands[j / MOTORS][j % MOTORS];
        airpuck_real above = command - airpuck_tuned.command_min;
        qp->hessian[airpuck_qp_row(COMMANDS, j)] = used + horizon->damping;
        qp->gradient[j] = used * above;
        qp->lower[j] = -above;
        qp->upper[j] = airpuck_tuned.command_max - command;
    }
    for (int k = 0; k < AIRPUCK_STEPS; k++) {
        stage at;
        linearise_step(p, k, &at);
        look_at(p, k, &at);
        move_columns(p, k, &at);
        add_costs(p, k, &at, qp);
        add_limits(p, k, &at, qp);
    }
}

/* Return which limits are active at the solution. */
static int active_limits(const airpuck_qp *qp)
{
    int limits = 0;
    for (int i = 0; i < qp->active; i++) {
        int row = qp->working[i] - COMMANDS, kind = row < 0 ? 0 : row % AIRPUCK_LIMITS;
        if (qp->dual[i] == 0)
            continue;
        if (row < 0)
            limits |= AIRPUCK_MOTOR_ACTIVE;
        else if (kind < 2)
            limits |= AIRPUCK_RAIL_ACTIVE;
        else if (AIRPUCK_LIMITS_SPEED && kind == 2)
            limits |= AIRPUCK_SPEED_ACTIVE;
        else if (AIRPUCK_LIMITS_SPIN && kind == 2 + AIRPUCK_LIMITS_SPEED)
            limits |= AIRPUCK_SPIN_ACTIVE;
        else
            limits |= AIRPUCK_DISC_ACTIVE;
    }
    return limits;
}

/* Whether the solver found a plan. */
static int found(airpuck_qp_status status)
{
    return status == AIRPUCK_QP_SOLVED || status == AIRPUCK_QP_SOFTENED;
}

/* Solve the program and update the plan. Start from the last active set, or from an empty one if
 * the last one failed. Return the outcome. */
static airpuck_qp_status improve(airpuck *craft, const airpuck_target targets[AIRPUCK_TARGETS])
{
    airpuck_plan *plan = &craft->plan;
    airpuck_qp qp;
    prediction p;
    airpuck_qp_begin(&qp, COMMANDS, AIRPUCK_ROWS, AIRPUCK_ROWS, craft->numbers, craft->working,
                     plan->active);
    /* The solver's factor is free until the program is solved. */
    p.craft = craft;
    p.targets = targets;
    p.states = (airpuck_real(*)[STATES])qp.factor;
    p.bend = (airpuck_real(*)[MOTORS])(qp.factor + AIRPUCK_STEPS * STATES);
    p.moved = (airpuck_real(*)[COMMANDS])(qp.factor + AIRPUCK_STEPS * (STATES + MOTORS));
    memcpy(p.start, craft->state, sizeof craft->state);
    memcpy(p.start + 6, craft->motor_speed, sizeof craft->motor_speed);
    choose_direction(&p);
    predict_states(&p);
    /* The acceleration at the end of the first step of the shifted plan. */
    airpuck_acceleration(&airpuck_identified, p.states[0] + 2, p.states[0] + 6, craft->request);
    for (int axis = 0; axis < 3; axis++)
        craft->request[axis] += craft->disturbance[axis];
    add_curvature(&p);
    form(&p, &qp);
    qp.iteration_limit = horizon->iterations;
    qp.penalty = horizon->penalty;
    if (plan->astray)
        memset(plan->active, AIRPUCK_QP_INACTIVE, sizeof plan->active);
    airpuck_qp_status status = airpuck_qp_solve(&qp);
    craft->iterations = qp.iterations;
    plan->astray = !found(status) && !plan->astray;
    if (!found(status))
        return status;
    plan->limits = active_limits(&qp);
    plan->way = p.apart;
    for (int j = 0; j < COMMANDS; j++) {
        airpuck_real *changed = &plan->commands[j / MOTORS][j % MOTORS];
        *changed = airpuck_clipped(*changed + qp.x[j], airpuck_tuned.command_min,
                                   airpuck_tuned.command_max);
    }
    return status;
}

airpuck_status airpuck_mpc(airpuck *craft, double now,
                           const airpuck_target targets[AIRPUCK_TARGETS],
                           airpuck_real command[AIRPUCK_MOTORS])
{
    airpuck_plan *plan = &craft->plan;
    double elapsed = now - plan->since;
    if (!(0 <= elapsed && elapsed <= (double)horizon->step * AIRPUCK_STEPS))
        begin_commands(plan);
    else if (elapsed > 0)
        shift(plan, (airpuck_real)elapsed);
    plan->since = now;
    plan->limits = 0;
    airpuck_qp_status solved = improve(craft, targets);
    if (found(solved)) {
        plan->answered = now;
        memcpy(command, plan->commands[0], sizeof plan->commands[0]);
        return solved == AIRPUCK_QP_SOLVED ? AIRPUCK_OPTIMAL : AIRPUCK_SOFTENED;
    }
    if (now - plan->answered <= horizon->flown_on) {
        memcpy(command, plan->commands[0], sizeof plan->commands[0]);
        return AIRPUCK_ITERATION_LIMIT;
    }
    airpuck_status status = airpuck_lqr(craft, targets, command);
    begin_commands(plan);
    return status == AIRPUCK_FAILED ? status : AIRPUCK_FALLBACK;
}

#else
/* C does not allow empty files. */
typedef int airpuck_not_predictive;
#endif
