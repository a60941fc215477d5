#include "guard.h"

/* Bits of a status word that tell the state, and those of operation enabled. Source: CiA 402-2, 6041h. */
enum { STATE_BITS = 0x6F, OPERATION_ENABLED = 0x27 };

integer guard_accepts(struct guard *guard, real position_rad, integer missing)
{
    guard->cycles++;
    if (missing) {
        guard->may_be_late = 2;
        return 1;
    }
    if (guard->has_last) {
        const integer periods = guard->cycles + (guard->may_be_late > 0);
        const real distance = FABS(position_rad - guard->last_rad);
        if (distance > guard->reach_rad * (real)periods) {
            guard->wild++;
            guard->wild_rps = distance / ((real)guard->cycles * guard->period_s * 2.0 * PI);
            guard->discarded++;
            return 0;
        }
    }
    guard->has_last = 1;
    guard->last_rad = position_rad;
    guard->cycles = guard->wild = 0;
    if (guard->may_be_late) {
        guard->may_be_late--;
    }
    return 1;
}

integer guard_check(
    struct guard *guard, integer status_word, real position_rad, real reference_rad, real torque_nm, integer missing)
{
    if (missing) {
        return missing >= guard->missing_limit ? SILENT : IN_ORDER;
    }
    if ((status_word & STATE_BITS) != OPERATION_ENABLED) {
        return NOT_IN_OPERATION;
    }
    if (guard->wild >= WILD_LIMIT) {
        return TOO_FAST;
    }
    if (!(guard->low_rad <= position_rad && position_rad <= guard->high_rad)) {
        return BEYOND_LIMITS;
    }
    if (FABS(torque_nm) > guard->torque_nm) {
        return TOO_MUCH_TORQUE;
    }
    if (FABS(position_rad - reference_rad) > guard->window_rad) {
        guard->beyond_s += guard->period_s;
        return guard->beyond_s > guard->window_s ? TOO_FAR_BEHIND : IN_ORDER;
    }
    guard->beyond_s = 0.0;
    return IN_ORDER;
}

void guard_skip(struct guard *guard)
{
    guard->has_last = 0;
}
