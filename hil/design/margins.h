/* Margins of a loop at many motor speeds and for many plants at once. */
#ifndef HIL_MARGINS_H
#define HIL_MARGINS_H

#include "hil/control/real.h"

/* Peak M_s of the sensitivity; gain margin in dB, infinite where the phase never crosses -180 degrees; phase margin in degrees,
 * 180 where |L| never crosses 1; turns of 1 + L round 0 against the loop without filters. */
enum { MARGIN_SENSITIVITY, MARGIN_GAIN, MARGIN_PHASE, MARGIN_TURNS, MARGIN_COLUMNS };

/* A complex number, as arrays of complex numbers have it. */
struct complex_real {
    real re;
    real im;
};

/* Margins of every plant at every speed.
 *
 * delay is e^-jwT at each of count frequencies, rising; bare holds the open loops without filters, plants rows of count;
 * coefficients holds b0, b1, b2, a1, a2 of the filters in series at each of speeds speeds; response is room for count numbers;
 * margins becomes MARGIN_COLUMNS numbers for every speed of every plant. */
void scan_margins(
    const struct complex_real *delay, const struct complex_real *bare, integer count, integer plants,
    const real *coefficients, integer speeds, integer filters, struct complex_real *response, real *margins);

#endif
