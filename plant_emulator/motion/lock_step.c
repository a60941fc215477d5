#if defined(__GNUC__) && defined(__x86_64__)
#define FOUR_LANES
#include <cpuid.h>
#endif

#include "group.h"

/* Has the processor the vectors, and does the system keep them? */
static int has_vectors(void)
{
#ifdef FOUR_LANES
    static int known = -1; /* asking may take longer than a period */
    if (known < 0) {
        unsigned a, b, c, d, kept = 0, more;
        if (__get_cpuid(1, &a, &b, &c, &d) && (c & bit_OSXSAVE) != 0) {
            __asm__("xgetbv" : "=a"(kept), "=d"(more) : "c"(0));
        }
        known = (kept & 6) == 6 && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2) != 0;
    }
    return known;
#else
    return 0;
#endif
}

LANED static void advance_four(integer periods, real period_s, integer substeps, const struct advancing *axes, int count)
{
    advance_group(periods, period_s, substeps, axes, count);
}

int advance_in_lock_step(integer periods, real period_s, integer substeps, const struct advancing *axes, int count)
{
    if (count < 2 || count > LANES || !has_vectors()) {
        return 0;
    }
    advance_four(periods, period_s, substeps, axes, count);
    return 1;
}
