/* The law of one axis in a drive: how it is set up, and how the interrupt of the current loop calls it every 250 us.
 *
 * On the emulated board it prints the instructions of a step with two notches, and of one without.
 */
#include "hil/control/servo.h"

#define PERIOD_S 250e-6f
#define TORQUE_LIMIT_NM 1.5f
#define STEPS 4000

struct law law_of_the_axis;

/* What a drive calls when it is enabled: gains and filters of the parameter set, then the motor as it is. */
static void enable(float motor_angle_rad, int with_notches)
{
    struct law *law = &law_of_the_axis;
    law->cascade_config.position_gain_per_s = 25.0f;
    law->cascade_config.velocity_gain_nm_s_rad = 0.03f;
    law->cascade_config.velocity_integral_gain_nm_rad = 0.5f;
    law->cascade_config.lowpass_hz = 300.0f;
    for (int column = 0; column < NOTCHES; column++) {
        struct notch_config *notch = &law->notch_config[column];
        notch->mode = with_notches ? NOTCH_SWITCHED : NOTCH_OFF;
        notch->order = column == 0 ? 2.0f : 1.0f;
        notch->start_rps = 4.0f;
        notch->end_rps = 9.0f;
        notch->offset_hz = 0.5f;
        notch->zeta_rn = 0.028f;
        notch->zeta_rdth = 0.1f;
        notch->hysteresis_rps = 0.15f;
        notch->speed_lowpass_hz = 50.0f;
        notch->ramp_rps = 1.0f;
    }
    servo_start(law, motor_angle_rad, 0.0f, 0.0f);
}

/* What the interrupt calls every 250 us; returns the torque command in N m. */
static float every_period(float position_rad, float motor_angle_rad)
{
    return servo_step(&law_of_the_axis, PERIOD_S, TORQUE_LIMIT_NM, position_rad, 0.0f, 0.0f, motor_angle_rad);
}

/* The rest is the emulated board: its clock, its output, and its start. */

#define TIMER_CONTROL (*(volatile unsigned *)0x40000000u) /* CMSDK timer 0 */
#define TIMER_VALUE (*(volatile unsigned *)0x40000004u)
#define TIMER_RELOAD (*(volatile unsigned *)0x40000008u)

static volatile float sink;

static void semihosting(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void print(const char *text)
{
    semihosting(0x04, text);
}

static void print_number(unsigned number)
{
    char text[11];
    int at = 10;
    text[at] = 0;
    do {
        text[--at] = (char)('0' + number % 10u);
        number /= 10u;
    } while (number != 0u);
    print(text + at);
}

/* Ticks of the timer for STEPS steps at 6 rev/s, where both notches act if there are any. */
static unsigned ticks(int with_notches)
{
    const float step_rad = 6.0f * 2.0f * 3.14159265f * PERIOD_S;
    enable(0.0f, with_notches);
    float angle = 0.0f;
    for (int i = 0; i < 2000; i++) { /* until the low-passed speed has come to the band of the notches */
        angle += step_rad;
        sink = every_period(angle + 0.01f, angle);
    }
    TIMER_RELOAD = 0xffffffffu;
    TIMER_VALUE = 0xffffffffu;
    TIMER_CONTROL = 1u;
    const unsigned begin = TIMER_VALUE;
    for (int i = 0; i < STEPS; i++) {
        angle += step_rad;
        sink = every_period(angle + 0.01f, angle);
    }
    const unsigned end = TIMER_VALUE;
    TIMER_CONTROL = 0u;
    return begin - end;
}

static void report(const char *what, unsigned of)
{
    /* the timer counts at 25 MHz while qemu counts an instruction as a nanosecond: 40 instructions a tick */
    print(what);
    print_number((of * 40u + STEPS / 2u) / STEPS);
    print(" instructions a step\n");
}

__attribute__((noreturn)) void reset(void)
{
    *(volatile unsigned *)0xe000ed88u |= 0xfu << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n isb");
    report("one axis without notches: ", ticks(0));
    report("one axis with two notches: ", ticks(1));
    print(law_of_the_axis.notch_state[0].active != 0 ? "both notches acted\n" : "the notches did not act\n");
    semihosting(0x18, (const void *)0x20026); /* the program has ended */
    for (;;) {
    }
}

extern unsigned stack_top;
__attribute__((section(".vectors"), used)) static const void *const vectors[] = {&stack_top, (const void *)reset};
