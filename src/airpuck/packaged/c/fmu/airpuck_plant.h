/* Copyright (c) 2026, the airpuck authors. SPDX-License-Identifier: BSD-2-Clause */
/* A craft on its table: radio with delay, motors, rails, and a camera that measures the pose.
 *
 * The laws are those of airpuck's simulated table, with its integration steps. Steps end when a
 * command arrives or a camera frame is due, so results do not depend on how often the plant is
 * asked. Times are in seconds from the start. */
#ifndef AIRPUCK_PLANT_H
#define AIRPUCK_PLANT_H

#include "airpuck_model.h"
#include <stdint.h>

#ifdef AIRPUCK_SINGLE
#error "times of events need double precision"
#endif

/* Commands, and poses, that can be in transit at once. */
enum { AIRPUCK_IN_TRANSIT = 1024 };

/* Numbers of the craft that only a contact with a rail needs [kg, kg m^2, m]. */
typedef struct {
    double mass, inertia, radius;
} airpuck_disc;
extern const airpuck_disc airpuck_craft;

/* A variable of the unit by its value reference, which indexes airpuck_variables: its causality is
 * 't' (time), 'p' (parameter), 'i' (input) or 'o' (output); its value must lie in [low, high]. */
typedef struct {
    const char *name;
    char causality;
    double start, low, high;
} airpuck_variable;
extern const airpuck_variable airpuck_variables[AIRPUCK_VARIABLES];

/* Messages in transit, oldest first; a message is a command or a pose. */
enum { AIRPUCK_MESSAGE = AIRPUCK_MOTORS > 4 ? AIRPUCK_MOTORS : 4 };
typedef struct {
    int first, count;
    double last_arrival;
    double arrival[AIRPUCK_IN_TRANSIT], content[AIRPUCK_IN_TRANSIT][AIRPUCK_MESSAGE];
} airpuck_link;

typedef struct {
    double value[AIRPUCK_VARIABLES];
    airpuck_model model;
    /* State, and its time: that of the last event or integration step. */
    double time, state[AIRPUCK_STATES];
    /* Commands that the motors follow. */
    double drive[AIRPUCK_MOTORS];
    airpuck_link radio, camera;
    /* Frames taken since the start. */
    double frames;
    uint64_t radio_random, camera_random;
} airpuck_plant;

/* Set all variables to their start values. */
void airpuck_plant_reset(airpuck_plant *plant);

/* Begin at time 0 from the present parameters; return NULL, or what is wrong with them. */
const char *airpuck_plant_start(airpuck_plant *plant);

/* Send the command in the variables by radio at a time; return NULL or what is wrong. */
const char *airpuck_plant_send(airpuck_plant *plant, double time);

/* Simulate until a time and set the outputs; return NULL or what is wrong. */
const char *airpuck_plant_run(airpuck_plant *plant, double time);

#endif
