/* The exported controller for ctypes: doubles in either precision, and its fields as arrays. */
#include "airpuck.h"

static void narrowed(const double *given, airpuck_real *result, int count)
{
    for (int i = 0; i < count; i++)
        result[i] = (airpuck_real)given[i];
}

static double *widened(const airpuck_real *given, double *result, int count)
{
    for (int i = 0; i < count; i++)
        result[i] = given[i];
    return result + count;
}

size_t access_size(void);
void access_pose(airpuck *craft, double stamp, const double *pose);
void access_sent(airpuck *craft, double time, const double *command);
int access_step(airpuck *craft, double now, const double *given, double *command);
int access_replay(airpuck *craft, const double *given, const double *events, int count);
void access_estimate(const airpuck *craft, double *result);
int access_limits(const airpuck *craft, int *active);
int access_iterations(const airpuck *craft);
void access_plan(airpuck *craft, const double *commands, double since, double answered, double way);

size_t access_size(void)
{
    return sizeof(airpuck);
}

void access_pose(airpuck *craft, double stamp, const double *pose)
{
    airpuck_real own[3];
    narrowed(pose, own, 3);
    airpuck_pose(craft, stamp, own);
}

void access_sent(airpuck *craft, double time, const double *command)
{
    airpuck_real own[AIRPUCK_MOTORS];
    narrowed(command, own, AIRPUCK_MOTORS);
    airpuck_sent(craft, time, own);
}

/* Targets are states, then accelerations, one row after the other. */
int access_step(airpuck *craft, double now, const double *given, double *command)
{
    airpuck_target targets[AIRPUCK_TARGETS];
    airpuck_real own[AIRPUCK_MOTORS];
    for (int i = 0; i < AIRPUCK_TARGETS; i++) {
        narrowed(given + 9 * i, targets[i].state, 6);
        narrowed(given + 9 * i + 6, targets[i].acceleration, 3);
    }
    airpuck_status status = airpuck_step(craft, now, targets, own);
    widened(own, command, AIRPUCK_MOTORS);
    return (int)status;
}

/* Repeat a flight from its beginning; return the number of control steps. Each event has
 * 3 + AIRPUCK_MOTORS numbers: a kind (0 pose, 1 step, 2 sent), a time, then the pose or command. */
int access_replay(airpuck *craft, const double *given, const double *events, int count)
{
    double command[AIRPUCK_MOTORS];
    int steps = 0;
    airpuck_init(craft);
    for (int i = 0; i < count; i++) {
        const double *event = events + i * (3 + AIRPUCK_MOTORS);
        if (event[0] == 0)
            access_pose(craft, event[1], event + 2);
        else if (event[0] == 2)
            access_sent(craft, event[1], event + 2);
        else
            steps += access_step(craft, event[1], given, command) >= 0;
    }
    return steps;
}

/* Request, state, disturbance, motor speeds. */
void access_estimate(const airpuck *craft, double *result)
{
    result = widened(craft->request, result, 3);
    result = widened(craft->state, result, 6);
    result = widened(craft->disturbance, result, 3);
    widened(craft->motor_speed, result, AIRPUCK_MOTORS);
}

/* Of the last quadratic program. */
int access_iterations(const airpuck *craft)
{
    return craft->iterations;
}

/* Which limits of the last plan are active; return their number. */
int access_limits(const airpuck *craft, int *active)
{
#if AIRPUCK_STEPS > 0
    int count = AIRPUCK_COMMANDS + AIRPUCK_ROWS;
    for (int i = 0; i < count; i++)
        active[i] = craft->plan.active[i] != 0;
    return count;
#else
    (void)craft;
    (void)active;
    return 0;
#endif
}

/* Replace the plan. */
void access_plan(airpuck *craft, const double *commands, double since, double answered, double way)
{
#if AIRPUCK_STEPS > 0
    for (int b = 0; b < AIRPUCK_BLOCKS; b++)
        narrowed(commands + b * AIRPUCK_MOTORS, craft->plan.commands[b], AIRPUCK_MOTORS);
    craft->plan.since = since;
    craft->plan.answered = answered;
    craft->plan.way = (airpuck_real)way;
#else
    (void)craft;
    (void)commands;
    (void)(since + answered + way);
#endif
}
