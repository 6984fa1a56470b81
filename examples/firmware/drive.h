/* The drive signal: a sine by direct digital synthesis, in integers. One value per conversion, from the timer that also starts
 * the conversions, so that load and samples share one clock. */
#ifndef PROBE_DRIVE_H
#define PROBE_DRIVE_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t phase; /* 2^32 is one cycle */
    uint32_t step;
    uint16_t amplitude;
} probe_drive;

/* Set frequency (mHz, below half the rate) and amplitude (counts, at most 32767); the phase goes on, from 0 in an object of
 * zeros. The frequency is right to rate / 2^33. Returns false, and changes nothing, if an argument is not allowed. */
bool probe_drive_set(probe_drive *drive, uint32_t frequency_mhz, uint32_t rate_mhz, uint16_t amplitude);

/* Return the next value: amplitude x sin(phase), right to two counts. */
int16_t probe_drive_next(probe_drive *drive);

#endif
