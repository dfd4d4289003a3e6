/* Reads commands of a length, a state, commands and durations as doubles; writes the state after
 * them. The first number of a record is the count of commands; -1 asks for an acceleration. */
#include "airpuck_model.h"
#include <stdio.h>
#include <stdlib.h>

static int get(airpuck_real *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        double number;
        if (fread(&number, sizeof number, 1, stdin) != 1)
            return 0;
        numbers[i] = (airpuck_real)number;
    }
    return 1;
}

static void put(const airpuck_real *numbers, int count)
{
    for (int i = 0; i < count; i++) {
        double number = (double)numbers[i];
        fwrite(&number, sizeof number, 1, stdout);
    }
}

int main(void)
{
    enum { MOST = 64 };
    airpuck_real count, state[AIRPUCK_STATES], commands[MOST * AIRPUCK_MOTORS], durations[MOST];
    while (get(&count, 1)) {
        int steps = (int)count;
        if (!get(state, AIRPUCK_STATES))
            return 1;
        if (steps < 0) {
            airpuck_real rates[3];
            airpuck_acceleration(&airpuck_identified, state + 2, state + 6, rates);
            put(rates, 3);
            continue;
        }
        if (steps > MOST || !get(commands, steps * AIRPUCK_MOTORS) || !get(durations, steps))
            return 1;
        airpuck_predict(&airpuck_identified, state, commands, durations, steps);
        put(state, AIRPUCK_STATES);
    }
    return 0;
}
