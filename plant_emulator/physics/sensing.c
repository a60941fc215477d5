#include "sensing.h"

void sense(struct sections *sections, real *ring, integer size, const real *tip, integer periods, real *sensed)
{
    struct sections *row = sections;
    for (integer i = 0; i < periods; i++) {
        row->newest = (row->newest + 1) % size;
        for (int channel = 0; channel < CHANNELS; channel++) {
            real value = tip[CHANNELS * i + channel];
            for (int section = 0; section < SENSOR_SECTIONS; section++) {
                const real *c = row->coefficients[section];
                real *memory = row->memory[section][channel];
                const real out = c[0] * value + memory[0];
                memory[0] = c[1] * value - c[3] * out + memory[1];
                memory[1] = c[2] * value - c[4] * out;
                value = out;
            }
            ring[CHANNELS * row->newest + channel] = value;
        }
    }
    for (int channel = 0; channel < CHANNELS; channel++) {
        real total = 0.0;
        for (integer late = 0; late < 4; late++) {
            if (row->weights[late] != 0.0) {
                const integer at = (row->newest - row->first - late + size) % size;
                total += row->weights[late] * ring[CHANNELS * at + channel];
            }
        }
        sensed[channel] = total;
    }
}
