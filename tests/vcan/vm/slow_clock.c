/* Loaded before user-mode Linux: its clock runs SLOWNESS times slower than the computer's.
 *
 * The machine's processor is a process among others, several times slower than the computer's, and stands still for tenths of a
 * second where others compute. By its own clock it is faster by SLOWNESS, and its standstills are shorter by as much. The kernel
 * (6.1) reads CLOCK_MONOTONIC for all that passes in it, and waits by one timer of it; the time of day is read at its start only.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#ifndef SLOWNESS
#define SLOWNESS 4
#endif

static const int64_t NS_PER_S = 1000000000;
static int64_t begin_ns; /* the two clocks agree here */

static struct timespec times(struct timespec time, int64_t numerator, int64_t denominator)
{
    int64_t ns = (time.tv_sec * NS_PER_S + time.tv_nsec) * numerator / denominator;
    return (struct timespec){ ns / NS_PER_S, ns % NS_PER_S };
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int failed = (int)syscall(SYS_clock_gettime, clock, now);
    if (failed || clock != CLOCK_MONOTONIC)
        return failed;
    int64_t ns = now->tv_sec * NS_PER_S + now->tv_nsec;
    if (!begin_ns)
        begin_ns = ns;
    ns = begin_ns + (ns - begin_ns) / SLOWNESS;
    *now = (struct timespec){ ns / NS_PER_S, ns % NS_PER_S };
    return 0;
}

int timer_settime(timer_t timer, int flags, const struct itimerspec *wanted, struct itimerspec *before)
{
    static int (*next)(timer_t, int, const struct itimerspec *, struct itimerspec *);
    if (!next)
        next = dlsym(RTLD_NEXT, "timer_settime");
    struct itimerspec slower = { times(wanted->it_interval, SLOWNESS, 1), times(wanted->it_value, SLOWNESS, 1) };
    int failed = next(timer, flags, &slower, before);
    if (!failed && before)
        *before = (struct itimerspec){ times(before->it_interval, 1, SLOWNESS), times(before->it_value, 1, SLOWNESS) };
    return failed;
}

int timer_gettime(timer_t timer, struct itimerspec *left)
{
    static int (*next)(timer_t, struct itimerspec *);
    if (!next)
        next = dlsym(RTLD_NEXT, "timer_gettime");
    int failed = next(timer, left);
    if (!failed)
        *left = (struct itimerspec){ times(left->it_interval, 1, SLOWNESS), times(left->it_value, 1, SLOWNESS) };
    return failed;
}
