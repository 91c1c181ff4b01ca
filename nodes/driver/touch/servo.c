/* The servo loop of an HDAPI device, in C so that it needs neither Python nor its interpreter lock.

   The vendor's library calls `servo_tick` once per servo tick, from a thread of its own. */

#include "../hardware/mailbox.h"

#include <pthread.h>
#include <signal.h>

#define HD_CURRENT_BUTTONS 0x2000u
#define HD_CURRENT_POSITION 0x2050u
#define HD_CURRENT_VELOCITY 0x2051u
#define HD_CURRENT_TRANSFORM 0x2052u
#define HD_CURRENT_FORCE 0x2700u
#define HD_FORCE_OUTPUT 0x4000u
#define HD_CALLBACK_DONE 0u
#define HD_CALLBACK_CONTINUE 1u

/* Looks at beginnings and ends of ticks, in which some went by. */
#define BACK_AFTER 3

typedef struct {
    unsigned int error;
    int internal;
    unsigned int device;
} hd_error;

typedef struct {
    mailbox box;
    /* Set before the start. */
    void (*begin_frame)(unsigned int);
    void (*end_frame)(unsigned int);
    void (*make_current)(unsigned int);
    void (*get_double)(unsigned int, double *);
    void (*get_integer)(unsigned int, int *);
    void (*set_double)(unsigned int, const double *);
    hd_error (*get_error)(void);
    void (*enable)(unsigned int);
    void (*disable)(unsigned int);
    unsigned int device;
    /* Its own: beginnings and ends of ticks, whether forces are cut because one does not end, and who looks after that. */
    unsigned int turns;
    int cut;
    int watched;
    pthread_t watch;
} servo;

size_t servo_size(void) { return sizeof(servo); }

/* The orientation in a transform of HDAPI: 4 × 4, column by column. */
static void orientation(const double *t, double *q) {
    double w = sqrt(fmax(0.0, 1.0 + t[0] + t[5] + t[10])) / 2.0;
    double x = sqrt(fmax(0.0, 1.0 + t[0] - t[5] - t[10])) / 2.0;
    double y = sqrt(fmax(0.0, 1.0 - t[0] + t[5] - t[10])) / 2.0;
    double z = sqrt(fmax(0.0, 1.0 - t[0] - t[5] + t[10])) / 2.0;
    q[0] = copysign(x, t[6] - t[9]);
    q[1] = copysign(y, t[8] - t[2]);
    q[2] = copysign(z, t[1] - t[4]);
    q[3] = w;
}

unsigned int servo_tick(void *data) {
    servo *s = data;
    double sample[SAMPLE] = {NAN, NAN, NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0}, transform[16] = {0.0}, force[3];
    int buttons = 0, failed = 0;
    __atomic_add_fetch(&s->turns, 1, __ATOMIC_RELEASE);
    /* Of several devices in one process, what follows is meant for this one. */
    s->make_current(s->device);
    s->begin_frame(s->device);
    s->get_double(HD_CURRENT_POSITION, sample + POSITION);
    s->get_double(HD_CURRENT_VELOCITY, sample + VELOCITY);
    s->get_double(HD_CURRENT_TRANSFORM, transform);
    s->get_integer(HD_CURRENT_BUTTONS, &buttons);
    orientation(transform, sample + ORIENTATION);
    sample[BUTTONS] = buttons;
    /* What was meant for the place before a gap is no force for the place after it. */
    mailbox_force(&s->box, force, __atomic_load_n(&s->cut, __ATOMIC_ACQUIRE));
    s->set_double(HD_CURRENT_FORCE, force);
    s->end_frame(s->device);
    for (int n = 0; n < 16; n++) {
        hd_error error = s->get_error();
        if (!error.error) break;
        mailbox_failed(&s->box, (int) error.error, 1);
        failed = 1;
    }
    /* What could not be read is no position: it is left untouched, and nothing is put. */
    if (!failed) {
        mailbox_sampled(&s->box, sample);
        mailbox_ticked(&s->box);
    }
    __atomic_add_fetch(&s->turns, 1, __ATOMIC_RELEASE);
    return s->box.stop ? HD_CALLBACK_DONE : HD_CALLBACK_CONTINUE;
}

/* A call of the device that does not return holds the force that is on it. So forces are switched off from here, in a thread of
   its own; and on again after a few ticks, which give none. The driver has lost the position meanwhile, and comes back by a ramp. */
static void *look(void *data) {
    servo *s = data;
    const struct timespec pause = {0, 2000000L};
    unsigned int seen = 0, turns, goes_on = 0;
    double since = mailbox_now();
    while (!__atomic_load_n(&s->box.stop, __ATOMIC_ACQUIRE)) {
        clock_nanosleep(CLOCK_MONOTONIC, 0, &pause, 0);
        turns = __atomic_load_n(&s->turns, __ATOMIC_ACQUIRE);
        if (turns != seen) {
            seen = turns;
            since = mailbox_now();
            if (!s->cut || ++goes_on < BACK_AFTER) continue;
            s->enable(HD_FORCE_OUTPUT);
            __atomic_store_n(&s->cut, 0, __ATOMIC_RELEASE);
        } else if (!s->cut && mailbox_now() - since > s->box.deadline) {
            goes_on = 0;
            __atomic_store_n(&s->cut, 1, __ATOMIC_RELEASE);
            __atomic_add_fetch(&s->box.let_go, 1, __ATOMIC_RELAXED);
            s->disable(HD_FORCE_OUTPUT);
        }
    }
    return 0;
}

/* Begin to look after ticks; signals are the node's. */
int servo_watch(servo *s) {
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int failed = pthread_create(&s->watch, 0, look, s);
    pthread_sigmask(SIG_SETMASK, &before, 0);
    s->watched = !failed;
    return failed;
}

/* End that; it is waited for a second, as a call of the device may hang. */
int servo_end(servo *s) {
    struct timespec until;
    if (!s->watched) return 0;
    __atomic_store_n(&s->box.stop, 1, __ATOMIC_RELEASE);
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += 1;
    int failed = pthread_timedjoin_np(s->watch, 0, &until);
    if (!failed) s->watched = 0;
    return failed;
}
