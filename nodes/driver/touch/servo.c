/* The servo loop of an HDAPI device, in C so that it needs neither Python nor its interpreter lock.

   The vendor's library calls `servo_tick` once per servo tick, from a thread of its own. */

#include "../hardware/mailbox.h"

#define HD_CURRENT_BUTTONS 0x2000u
#define HD_CURRENT_POSITION 0x2050u
#define HD_CURRENT_VELOCITY 0x2051u
#define HD_CURRENT_TRANSFORM 0x2052u
#define HD_CURRENT_FORCE 0x2700u
#define HD_CALLBACK_DONE 0u
#define HD_CALLBACK_CONTINUE 1u

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
    unsigned int device;
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
    /* Of several devices in one process, what follows is meant for this one. */
    s->make_current(s->device);
    s->begin_frame(s->device);
    s->get_double(HD_CURRENT_POSITION, sample + POSITION);
    s->get_double(HD_CURRENT_VELOCITY, sample + VELOCITY);
    s->get_double(HD_CURRENT_TRANSFORM, transform);
    s->get_integer(HD_CURRENT_BUTTONS, &buttons);
    orientation(transform, sample + ORIENTATION);
    sample[BUTTONS] = buttons;
    mailbox_force(&s->box, force);
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
    return s->box.stop ? HD_CALLBACK_DONE : HD_CALLBACK_CONTINUE;
}
