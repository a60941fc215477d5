/* Loaded before user-mode Linux: its clock counts what the machine has computed and idled, and no time in which others computed.
 *
 * A machine beside others stands still for tenths of a second, and by the computer's clock it would be late for no fault of what
 * runs in it. By this clock it computes SLOWNESS times faster than it does, since each of its switches between processes costs
 * that much; when it has nothing to do until a timer of its own, the clock jumps there.
 *
 * The kernel (6.1) reads CLOCK_MONOTONIC for all that passes in it, and waits by one timer of it; the time of day is read at its
 * start only. One process of the computer runs at a time: the kernel's own, or one of those that it traces and waits for, in
 * which its programs run. A timer that is early by this clock does no harm: the kernel sets it again for the rest.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#ifndef SLOWNESS
#define SLOWNESS 8
#endif

static const int64_t NS_PER_S = 1000000000;
static int64_t begin_ns;   /* the two clocks agree here */
static int64_t idle_ns;    /* what the clock has jumped */
static int64_t program_ns; /* processor time of the traced, while they were waited for */
static clockid_t program;  /* processor clock of the one that is waited for, or 0 */
static int64_t program_begin_ns;
static timer_t timer; /* the kernel's */
static int (*set)(timer_t, int, const struct itimerspec *, struct itimerspec *);

static int64_t ns_of(struct timespec time) { return time.tv_sec * NS_PER_S + time.tv_nsec; }

static struct timespec time_of(int64_t ns) { return (struct timespec){ ns / NS_PER_S, ns % NS_PER_S }; }

static int64_t read_ns(clockid_t clock, int64_t otherwise_ns)
{
    struct timespec now;
    return syscall(SYS_clock_gettime, clock, &now) ? otherwise_ns : ns_of(now); /* a process that has ended has no clock */
}

static int64_t own_ns(void)
{
    int64_t computed_ns = read_ns(CLOCK_PROCESS_CPUTIME_ID, 0) + program_ns;
    if (program)
        computed_ns += read_ns(program, program_begin_ns) - program_begin_ns;
    return idle_ns + computed_ns / SLOWNESS;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    if (clock != CLOCK_MONOTONIC)
        return (int)syscall(SYS_clock_gettime, clock, now);
    if (!begin_ns)
        begin_ns = read_ns(CLOCK_MONOTONIC, 0) - own_ns();
    *now = time_of(begin_ns + own_ns());
    return 0;
}

pid_t waitpid(pid_t pid, int *status, int options)
{
    static pid_t (*next)(pid_t, int *, int);
    if (!next)
        next = dlsym(RTLD_NEXT, "waitpid");
    clockid_t clock;
    if (pid <= 0 || clock_getcpuclockid(pid, &clock))
        return next(pid, status, options);
    program_begin_ns = read_ns(clock, 0);
    program = clock; /* an alarm may read the clock from here on */
    pid_t ended = next(pid, status, options);
    int64_t took_ns = read_ns(clock, program_begin_ns) - program_begin_ns;
    program = 0;
    program_ns += took_ns;
    return ended;
}

int timer_settime(timer_t which, int flags, const struct itimerspec *wanted, struct itimerspec *before)
{
    if (!set)
        set = dlsym(RTLD_NEXT, "timer_settime");
    timer = which;
    struct itimerspec slower = { time_of(ns_of(wanted->it_interval) * SLOWNESS), time_of(ns_of(wanted->it_value) * SLOWNESS) };
    int failed = set(which, flags, &slower, before);
    if (!failed && before)
        *before = (struct itimerspec){ time_of(ns_of(before->it_interval) / SLOWNESS), time_of(ns_of(before->it_value) / SLOWNESS) };
    return failed;
}

/* The kernel calls it when it has nothing to do and its timer is set. */
int sigsuspend(const sigset_t *mask)
{
    static int (*next)(const sigset_t *);
    if (!next)
        next = dlsym(RTLD_NEXT, "sigsuspend");
    struct itimerspec left;
    if (set && !timer_gettime(timer, &left) && ns_of(left.it_value) > 0) {
        idle_ns += ns_of(left.it_value) / SLOWNESS;
        left.it_value = time_of(1);
        set(timer, 0, &left, NULL);
    }
    return next(mask);
}
