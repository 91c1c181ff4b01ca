/* The servo loop of an HDAPI device, in C so that it needs neither Python nor its interpreter lock.

   The vendor's library calls `servo_tick` once per servo tick, from a thread of its own. Forces and positions go through two
   mailboxes, each guarded by a counter that is odd while it is written. When the driver has written no force for `deadline`
   ticks, or the device reported a fault, the force is zero: the last line of safety, which holds while Python hangs. */

#include <stddef.h>
#include <stdint.h>
#include <time.h>

#define HD_CURRENT_POSITION 0x2050u
#define HD_CURRENT_FORCE 0x2700u
#define HD_CALLBACK_DONE 0u
#define HD_CALLBACK_CONTINUE 1u
#define FAULT 1
#define STALLED 2
#define UNREAD 3

typedef struct {
    unsigned int error;
    int internal;
    unsigned int device;
} hd_error;

typedef struct {
    /* Set before the start. */
    void (*begin_frame)(unsigned int);
    void (*end_frame)(unsigned int);
    void (*get_double)(unsigned int, double *);
    void (*set_double)(unsigned int, const double *);
    hd_error (*get_error)(void);
    unsigned int device;
    unsigned int deadline;
    /* Written by the driver. */
    unsigned int commands;
    double force[3];
    unsigned int stop;
    unsigned int seen;
    double seen_at;
    double patience;
    /* Written by the servo thread. */
    unsigned int samples;
    double position[3];
    unsigned int ticks;
    unsigned int let_go;
    unsigned int errors;
    unsigned int fault;
    /* The servo thread's own. */
    unsigned int last_command;
    unsigned int silent;
    double held[3];
} servo;

static void put(unsigned int *counter, double *box, const double *value) {
    unsigned int n = __atomic_load_n(counter, __ATOMIC_RELAXED);
    __atomic_store_n(counter, n + 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    for (int i = 0; i < 3; i++) __atomic_store(&box[i], (double *) &value[i], __ATOMIC_RELAXED);
    __atomic_store_n(counter, n + 2, __ATOMIC_RELEASE);
}

/* Gives the counter that belongs to what was taken, or 0 when it is being written this moment. */
static unsigned int take(const unsigned int *counter, double *box, double *value) {
    unsigned int before = __atomic_load_n(counter, __ATOMIC_ACQUIRE);
    if (before & 1u) return 0;
    for (int i = 0; i < 3; i++) __atomic_load(&box[i], &value[i], __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    return __atomic_load_n(counter, __ATOMIC_RELAXED) == before ? before : 0;
}

size_t servo_size(void) { return sizeof(servo); }

void servo_write(servo *s, const double *force) { put(&s->commands, s->force, force); }

void servo_put(servo *s, const double *position) { put(&s->samples, s->position, position); }

int servo_read(servo *s, double *position) {
    for (int attempt = 0; attempt < 1000; attempt++) {
        if (take(&s->samples, s->position, position)) return 1;
    }
    return 0;
}

static double now(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (double) at.tv_sec + 1e-9 * (double) at.tv_nsec;
}

/* The two calls of a device (nodes/driver/calls.py): +x is forward, +y left, +z up, in metres; HDAPI's are right, up and towards the
   user, in millimetres. What is wrong is told by the status, and `out` is left alone then. */

int device_read(int64_t context, int64_t seq, double *out) {
    servo *s = (servo *) (intptr_t) context;
    double position[3];
    (void) seq;
    if (__atomic_load_n(&s->fault, __ATOMIC_RELAXED)) return -FAULT;
    unsigned int ticks = __atomic_load_n(&s->ticks, __ATOMIC_ACQUIRE);
    if (ticks != s->seen || s->seen_at == 0.0) {
        s->seen = ticks;
        s->seen_at = now();
    } else if (now() - s->seen_at > s->patience) {
        return -STALLED;
    }
    if (!servo_read(s, position)) return -UNREAD;
    out[0] = -position[2] * 1e-3;
    out[1] = -position[0] * 1e-3;
    out[2] = position[1] * 1e-3;
    return 0;
}

int device_write(int64_t context, const double *force, int64_t seq, double offset) {
    const double theirs[3] = {-force[1], force[2], -force[0]};
    (void) seq;
    (void) offset;
    servo_write((servo *) (intptr_t) context, theirs);
    return 0;
}

unsigned int servo_tick(void *data) {
    servo *s = data;
    double position[3], force[3];
    static const double zero[3] = {0.0, 0.0, 0.0};
    const double *out = s->held;
    s->begin_frame(s->device);
    s->get_double(HD_CURRENT_POSITION, position);
    servo_put(s, position);
    unsigned int command = take(&s->commands, s->force, force);
    if (command && command != s->last_command) {
        s->last_command = command;
        s->silent = 0;
        for (int i = 0; i < 3; i++) s->held[i] = force[i];
    } else if (s->silent < s->deadline && ++s->silent == s->deadline && s->last_command) {
        __atomic_add_fetch(&s->let_go, 1, __ATOMIC_RELAXED);
    }
    if (s->silent >= s->deadline || s->fault || s->stop || !s->last_command) out = zero;
    s->set_double(HD_CURRENT_FORCE, out);
    s->end_frame(s->device);
    for (int n = 0; n < 16; n++) {
        hd_error error = s->get_error();
        if (!error.error) break;
        __atomic_add_fetch(&s->errors, 1, __ATOMIC_RELAXED);
        if (!s->fault) __atomic_store_n(&s->fault, error.error, __ATOMIC_RELAXED);
    }
    __atomic_add_fetch(&s->ticks, 1, __ATOMIC_RELEASE);
    return s->stop ? HD_CALLBACK_DONE : HD_CALLBACK_CONTINUE;
}
