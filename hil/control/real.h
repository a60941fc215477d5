/* Numbers of the control law: double precision, or single precision where HIL_SINGLE is defined.
 *
 * Single precision is for drives. Compile it with -fsingle-precision-constant as well: a constant is a double in C.
 */
#ifndef HIL_REAL_H
#define HIL_REAL_H

#include <math.h>
#include <stdint.h>

#ifdef HIL_SINGLE
typedef float real;
typedef int32_t integer;
#define IN_REAL(function) function##f
#else
typedef double real;
typedef int64_t integer;
#define IN_REAL(function) function
#endif

#define COS IN_REAL(cos)
#define SIN IN_REAL(sin)
#define EXP IN_REAL(exp)
#define LOG IN_REAL(log)
#define SQRT IN_REAL(sqrt)
#define ATAN2 IN_REAL(atan2)
#define FABS IN_REAL(fabs)
#define COPYSIGN IN_REAL(copysign)

/* Of a function that is part of its callers, however large it is: a control period is made of few such. */
#ifdef __GNUC__
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif

/* From here on a number has no fraction. */
#ifdef HIL_SINGLE
#define WHOLE 8388608.0f /* 2^23 */
#else
#define WHOLE 4503599627370496.0 /* 2^52 */
#endif

#define PI ((real)3.141592653589793)

/* The smaller of two numbers; the first where neither is smaller, as where one is NaN. */
INLINED real least(real a, real b)
{
    return b < a ? b : a;
}

/* The larger of two numbers; the first where neither is larger, as where one is NaN. */
INLINED real most(real a, real b)
{
    return b > a ? b : a;
}

/* The nearest whole number, even where two are equally near: rint, which is a call of the library on some processors. */
INLINED real nearest_whole(real x)
{
    const real size = FABS(x);
    return size < WHOLE ? COPYSIGN((size + WHOLE) - WHOLE, x) : x;
}

/* The largest whole number that is not above x: floor, alike. */
INLINED real round_down(real x)
{
    const real nearest = nearest_whole(x);
    return nearest > x ? nearest - 1.0 : nearest;
}

#endif
