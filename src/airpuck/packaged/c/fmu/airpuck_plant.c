/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
#include "airpuck_plant.h"
#include <string.h>

static const double PI = 3.14159265358979323846;
/* Longest integration step [s]. */
static const double LONGEST_STEP = 1.0 / 240;

/* SplitMix64 (Steele, Lea and Flood 2014): a uniform number in [0, 1). */
static double uniform(uint64_t *random)
{
    uint64_t mixed = *random += 0x9e3779b97f4a7c15u;
    mixed = (mixed ^ (mixed >> 30)) * 0xbf58476d1ce4e5b9u;
    mixed = (mixed ^ (mixed >> 27)) * 0x94d049bb133111ebu;
    return (double)((mixed ^ (mixed >> 31)) >> 11) / 9007199254740992.0;
}

/* Return a normally distributed number, by the Box-Muller method. */
static double normal(uint64_t *random)
{
    double radius = sqrt(-2 * log(1 - uniform(random)));
    return radius * cos(2 * PI * uniform(random));
}

static double exponential(uint64_t *random, double mean)
{
    return -mean * log(1 - uniform(random));
}

/* Put a message in transit; later ones do not overtake it. Return whether there was room. */
static int put(airpuck_link *link, double arrival, const double *content, size_t size)
{
    int last = (link->first + link->count) % AIRPUCK_IN_TRANSIT;
    if (link->count == AIRPUCK_IN_TRANSIT)
        return 0;
    link->last_arrival = fmax(arrival, link->last_arrival);
    link->arrival[last] = link->last_arrival;
    memcpy(link->content[last], content, size * sizeof *content);
    link->count++;
    return 1;
}

static double next_arrival(const airpuck_link *link)
{
    return link->count ? link->arrival[link->first] : INFINITY;
}

static const double *take(airpuck_link *link)
{
    const double *content = link->content[link->first];
    link->first = (link->first + 1) % AIRPUCK_IN_TRANSIT;
    link->count--;
    return content;
}

void airpuck_plant_reset(airpuck_plant *plant)
{
    memset(plant, 0, sizeof *plant);
    for (int i = 0; i < AIRPUCK_VARIABLES; i++)
        plant->value[i] = airpuck_variables[i].start;
}

const char *airpuck_plant_start(airpuck_plant *plant)
{
    double *value = plant->value;
    double x = value[AIRPUCK_TABLE_LENGTH] / 2 - airpuck_craft.radius;
    double y = value[AIRPUCK_TABLE_WIDTH] / 2 - airpuck_craft.radius;
    if (x < 0 || y < 0)
        return "the table is smaller than the craft";
    if (fabs(value[AIRPUCK_START_X]) > x || fabs(value[AIRPUCK_START_Y]) > y)
        return "the craft starts beyond a rail";
    plant->model = airpuck_identified;
    plant->model.motor_time_constant = value[AIRPUCK_MOTOR_TIME_CONSTANT];
    plant->time = plant->frames = 0;
    for (int i = 0; i < AIRPUCK_STATES; i++)
        plant->state[i] = i < 6 ? value[AIRPUCK_START_X + i] : 0;
    for (int i = AIRPUCK_STATE; i < AIRPUCK_VARIABLES; i++)
        if (airpuck_variables[i].causality == 'o')
            value[i] = 0;
    memset(plant->drive, 0, sizeof plant->drive);
    plant->radio.count = plant->camera.count = 0;
    plant->radio.last_arrival = plant->camera.last_arrival = -INFINITY;
    /* Radio and camera have separate random sequences. */
    plant->radio_random = (uint64_t)value[AIRPUCK_SEED] << 32;
    plant->camera_random = ~plant->radio_random;
    return airpuck_plant_run(plant, 0);
}

const char *airpuck_plant_send(airpuck_plant *plant, double time)
{
    const double *value = plant->value, *command = value + AIRPUCK_COMMAND;
    double jitter = value[AIRPUCK_RADIO_JITTER] * normal(&plant->radio_random);
    double arrival = time + fmax(value[AIRPUCK_RADIO_DELAY] + jitter, 0);
    if (uniform(&plant->radio_random) < value[AIRPUCK_RADIO_LOSS])
        return NULL;
    if (!put(&plant->radio, arrival, command, AIRPUCK_MOTORS))
        return "too many commands are in transit: shorten radio.delay, or use longer steps";
    return NULL;
}

/* Set the impulse of a contact along its normal and tangent: restitution, and Coulomb friction,
 * which stops the slip if it can. The arms lead from the centre of mass to the contact. */
static void contact_impulse(const airpuck_plant *plant, double arm_n, double arm_t, double speed_n,
                            double slip, double impulse[2])
{
    const airpuck_disc *disc = &airpuck_craft;
    double restitution = plant->value[AIRPUCK_TABLE_RESTITUTION];
    double friction = plant->value[AIRPUCK_TABLE_FRICTION];
    double k_nn = 1 / disc->mass + arm_t * arm_t / disc->inertia;
    double k_tt = 1 / disc->mass + arm_n * arm_n / disc->inertia;
    double k_nt = -arm_n * arm_t / disc->inertia;
    double wanted_n = -(1 + restitution) * speed_n, wanted_t = -slip;
    double determinant = k_nn * k_tt - k_nt * k_nt;
    double n = (k_tt * wanted_n - k_nt * wanted_t) / determinant;
    double t = (k_nn * wanted_t - k_nt * wanted_n) / determinant;
    if (!(fabs(t) <= friction * n)) {
        double cone = friction * (double)((wanted_t > 0) - (wanted_t < 0));
        n = wanted_n / (k_nn + cone * k_nt);
        t = cone * n;
    }
    /* With friction and an offset centre of mass, Newton's law can add energy (Kane and Levinson
     * 1985). In that case the contact is treated as smooth. */
    double work =
        n * (speed_n + (k_nn * n + k_nt * t) / 2) + t * (slip + (k_nt * n + k_tt * t) / 2);
    impulse[0] = work > 0 ? wanted_n / k_nn : n;
    impulse[1] = work > 0 ? 0 : t;
}

/* Push back a craft that crossed a rail along one axis; return whether it did. */
static int bounce(const airpuck_plant *plant, double state[AIRPUCK_STATES], int axis)
{
    const airpuck_disc *disc = &airpuck_craft;
    double size = plant->value[axis ? AIRPUCK_TABLE_WIDTH : AIRPUCK_TABLE_LENGTH];
    double side = (double)((state[axis] > 0) - (state[axis] < 0));
    double depth = fabs(state[axis]) - (size / 2 - disc->radius);
    if (!(depth > 0 && side * state[3 + axis] > 0))
        return 0;

    /* The normal points into the table; the tangent is the normal turned by 90 degrees. */
    double nx = axis ? 0 : -side, ny = axis ? -side : 0;
    double rx, ry, impulse[2];
    airpuck_center_of_mass(&plant->model, cos(state[2]), sin(state[2]), &rx, &ry);
    double arm_n = -disc->radius - (rx * nx + ry * ny), arm_t = -(ry * nx - rx * ny);
    double slip = state[4] * nx - state[3] * ny - disc->radius * state[5];
    contact_impulse(plant, arm_n, arm_t, state[3] * nx + state[4] * ny, slip, impulse);

    /* Velocity of the centre of mass, then of the geometric centre, which turns about it. */
    double turned = (arm_n * impulse[1] - arm_t * impulse[0]) / disc->inertia;
    state[3] += (impulse[0] * nx - impulse[1] * ny) / disc->mass + turned * ry;
    state[4] += (impulse[0] * ny + impulse[1] * nx) / disc->mass - turned * rx;
    state[5] += turned;
    /* The penetration is reflected, scaled like the speed. */
    state[axis] -= side * depth * (1 + plant->value[AIRPUCK_TABLE_RESTITUTION]);
    return 1;
}

/* Advance a state by one integration step; return whether it met a rail. */
static int advance(const airpuck_plant *plant, double state[AIRPUCK_STATES], double duration)
{
    airpuck_model_step(&plant->model, state, plant->drive, duration);
    int met_x = bounce(plant, state, 0);
    return bounce(plant, state, 1) || met_x;
}

/* Report a contact: when it was detected, and the speed towards the rail before it. */
static void report_contact(airpuck_plant *plant, const double before[AIRPUCK_STATES])
{
    const double *after = plant->state;
    double fastest = 0;
    for (int axis = 0; axis < 2; axis++) {
        double size = plant->value[axis ? AIRPUCK_TABLE_WIDTH : AIRPUCK_TABLE_LENGTH];
        double towards = after[axis] < 0 ? -before[3 + axis] : before[3 + axis];
        double reached = fabs(after[axis]) + fabs(towards) * LONGEST_STEP;
        if (reached >= size / 2 - airpuck_craft.radius)
            fastest = fmax(fastest, towards);
    }
    plant->value[AIRPUCK_CONTACT_COUNT]++;
    plant->value[AIRPUCK_CONTACT_TIME] = plant->time;
    plant->value[AIRPUCK_CONTACT_SPEED] = fastest;
}

static void receive(airpuck_plant *plant)
{
    while (next_arrival(&plant->radio) <= plant->time)
        memcpy(plant->drive, take(&plant->radio), sizeof plant->drive);
}

/* Integrate towards an event, as far as whole steps end by a time. */
static void integrate(airpuck_plant *plant, double event, double until)
{
    while (plant->time < event) {
        double duration = fmin(event - plant->time, LONGEST_STEP);
        double end = duration == event - plant->time ? event : plant->time + duration;
        if (end > until)
            return;
        double before[AIRPUCK_STATES];
        memcpy(before, plant->state, sizeof before);
        int met = advance(plant, plant->state, duration);
        plant->time = end;
        if (met)
            report_contact(plant, before);
    }
}

/* Copy the last pose that arrived by a time to the outputs. */
static void deliver(airpuck_plant *plant, double time)
{
    double *value = plant->value;
    while (next_arrival(&plant->camera) <= time) {
        memcpy(value + AIRPUCK_POSE, take(&plant->camera), 4 * sizeof *value);
        value[AIRPUCK_POSE_COUNT]++;
    }
}

/* Take the camera frame that is due. All random numbers are always drawn, so that one setting does
 * not change the draws of another. */
static const char *photograph(airpuck_plant *plant, double time)
{
    const double *value = plant->value;
    uint64_t *random = &plant->camera_random;
    double pose[4] = {plant->state[0], plant->state[1], plant->state[2], time};
    for (int i = 0; i < 3; i++)
        pose[i] += normal(random) * value[i < 2 ? AIRPUCK_CAMERA_POSITION_NOISE
                                                : AIRPUCK_CAMERA_YAW_NOISE];
    pose[2] -= 2 * PI * floor((pose[2] + PI) / (2 * PI));
    double jitter = exponential(random, value[AIRPUCK_CAMERA_LATENCY_JITTER]);
    plant->frames++;
    deliver(plant, time);
    if (uniform(random) < value[AIRPUCK_CAMERA_DROPPED])
        return NULL;
    if (!put(&plant->camera, time + value[AIRPUCK_CAMERA_LATENCY] + jitter, pose, 4))
        return "too many poses are in transit: shorten camera.latency, or lower camera.rate";
    return NULL;
}

static void set_outputs(airpuck_plant *plant, double time)
{
    double *value = plant->value, *state = value + AIRPUCK_STATE;
    memcpy(state, plant->state, sizeof plant->state);
    if (time > plant->time)
        advance(plant, state, time - plant->time);
    deliver(plant, time);
    value[AIRPUCK_TIME] = time;
}

const char *airpuck_plant_run(airpuck_plant *plant, double time)
{
    const char *problem = NULL;
    while (!problem) {
        double frame = plant->frames / plant->value[AIRPUCK_CAMERA_RATE];
        receive(plant);
        double event = fmin(frame, next_arrival(&plant->radio));
        integrate(plant, event, time);
        if (event > time)
            break;
        if (frame <= event)
            problem = photograph(plant, frame);
    }
    set_outputs(plant, time);
    return problem;
}
