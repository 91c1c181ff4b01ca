/* What a driver and the servo loop of its device share: samples one way, forces the other, and the last line of safety.

   Each way is guarded by a counter that is odd while it is written, so neither side ever waits for the other. A force counts for
   `deadline` seconds; then, after a fault, and where it is no number, the device gets zero: this holds while Python hangs. So
   it does while no position is read, and a force comes back from that by a ramp: too short a loss is none for the driver. */

#ifndef HAPTIC_MAILBOX_H
#define HAPTIC_MAILBOX_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>

#define FAULT 1
#define STALLED 2
#define UNREAD 3

/* As in nodes/driver/safety.py: so much time of ramp costs a time without a force. */
#define REGAIN 5.0

/* A sample: position, velocity of the vendor, orientation as a quaternion (x, y, z, w), gripper, buttons as bits. */
#define POSITION 0
#define VELOCITY 3
#define ORIENTATION 6
#define GRIPPER 10
#define BUTTONS 11
#define SAMPLE 12

/* A force, and when the sample was asked for after which it was decided; 0 where none ever was. */
#define DECIDED 3
#define COMMAND 4

/* `device_read` gives a position that is elsewhere without a motion. */
#define JUMPED 1

typedef struct {
    /* Set before the start. Ours = turn · theirs · unit + origin; theirs = turnᵀ · ours for forces, so that power is the same. */
    double turn[9];
    double unit;
    double origin[3];
    double deadline;
    double patience;
    double peak;
    double reach;
    double back;
    double recovery;
    int64_t clutch;
    /* Written by the driver. */
    unsigned int commands;
    double force[COMMAND];
    unsigned int stop;
    unsigned int jumps;
    unsigned int told;
    double decided_at;
    unsigned int seen;
    double seen_at;
    int64_t held;
    double frozen[3];
    double shift[3];
    double share_from;
    /* Written by the servo loop. */
    unsigned int samples;
    double sample[SAMPLE];
    unsigned int ticks;
    unsigned int let_go;
    unsigned int errors;
    int error;
    int fault;
    int condition;
    /* The servo loop's own. */
    unsigned int last_command;
    unsigned int silent;
    double silent_at;
    double commanded_at;
    double acting[3];
    double looked_at;
    double owed;
} mailbox;

static inline double mailbox_now(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (double) at.tv_sec + 1e-9 * (double) at.tv_nsec;
}

static void mailbox_put(unsigned int *counter, double *box, const double *value, int size) {
    unsigned int n = __atomic_load_n(counter, __ATOMIC_RELAXED);
    __atomic_store_n(counter, n + 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    for (int i = 0; i < size; i++) __atomic_store(&box[i], (double *) &value[i], __ATOMIC_RELAXED);
    __atomic_store_n(counter, n + 2, __ATOMIC_RELEASE);
}

/* Gives the counter that belongs to what was taken, or 0 when there is nothing yet or it is being written this moment. */
static unsigned int mailbox_take(const unsigned int *counter, double *box, double *value, int size) {
    unsigned int before = __atomic_load_n(counter, __ATOMIC_ACQUIRE);
    if (before & 1u) return 0;
    for (int i = 0; i < size; i++) __atomic_load(&box[i], &value[i], __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    return __atomic_load_n(counter, __ATOMIC_RELAXED) == before ? before : 0;
}

/* -- the servo loop's side ---------------------------------------------------------------------------------------------- */

/* Put a sample that was read, whole. */
void mailbox_sampled(mailbox *m, const double *sample) { mailbox_put(&m->samples, m->sample, sample, SAMPLE); }

/* Note that a call of the device failed; a `fatal` one ends forces for good. */
void mailbox_failed(mailbox *m, int error, int fatal) {
    __atomic_add_fetch(&m->errors, 1, __ATOMIC_RELAXED);
    __atomic_store_n(&m->error, error, __ATOMIC_RELAXED);
    if (fatal && !m->fault) __atomic_store_n(&m->fault, error, __ATOMIC_RELAXED);
}

/* End a tick of the servo loop in which the position was read. */
void mailbox_ticked(mailbox *m) { __atomic_add_fetch(&m->ticks, 1, __ATOMIC_RELEASE); }

/* The force that the device gets now, in its own axes, zero where it is `blind`, without a position; whether one acts. */
int mailbox_force(mailbox *m, double *out, int blind) {
    double force[COMMAND], now = mailbox_now();
    if (m->last_command && !m->silent && now - m->commanded_at > m->deadline) {
        m->silent = 1;
        m->silent_at = m->commanded_at + m->deadline;
        __atomic_add_fetch(&m->let_go, 1, __ATOMIC_RELAXED);
    }
    int is_old = 0;
    unsigned int command = mailbox_take(&m->commands, m->force, force, COMMAND);
    if (command && command != m->last_command) {
        m->last_command = command;
        /* A force that was decided before the device let go of the one before it must not bring that back: its driver was held
           up on the way here, does not know, and goes on from a force that is none. So it comes back by a ramp. */
        is_old = m->silent && force[DECIDED] != 0.0 && force[DECIDED] < m->silent_at;
        if (!is_old) {
            m->commanded_at = now;
            m->silent = 0;
        }
        for (int i = 0; i < 3; i++) {
            m->acting[i] = isfinite(force[i]) ? fmin(fmax(force[i], -m->peak), m->peak) : 0.0;
        }
    }
    double passed = m->looked_at != 0.0 ? now - m->looked_at : 0.0;
    m->looked_at = now;
    if (is_old) m->owed = m->recovery;
    m->owed = blind ? fmin(m->owed + REGAIN * passed, m->recovery) : fmax(m->owed - passed, 0.0);
    double share = m->owed > 0.0 ? 1.0 - m->owed / m->recovery : 1.0;
    int acts = m->last_command && !m->silent && !m->fault && !m->stop && !blind;
    for (int i = 0; i < 3; i++) out[i] = acts ? share * m->acting[i] : 0.0;
    return acts;
}

/* -- the driver's side: the two calls of a device (nodes/driver/calls.py) ------------------------------------------------- */

size_t mailbox_size(void) { return sizeof(mailbox); }

/* Take the newest sample as it stands; 0, or why there is none. */
int mailbox_sample(mailbox *m, double *sample) {
    if (__atomic_load_n(&m->fault, __ATOMIC_RELAXED)) return -FAULT;
    double now = mailbox_now();
    unsigned int ticks = __atomic_load_n(&m->ticks, __ATOMIC_ACQUIRE);
    if (ticks != m->seen || m->seen_at == 0.0) {
        m->seen = ticks;
        m->seen_at = now;
    } else if (now - m->seen_at > m->patience) {
        return -STALLED;
    }
    for (int attempt = 0; attempt < 1000; attempt++) {
        if (mailbox_take(&m->samples, m->sample, sample, SAMPLE)) return 0;
    }
    return -UNREAD;
}

/* While the clutch is held the scene stands still and the device moves on without a force; then it goes on from there. */
static void mailbox_clutch(mailbox *m, const double *sample, double *out) {
    int held = ((int64_t) sample[BUTTONS] & m->clutch) != 0, is_jump = 0;
    for (int i = 0; i < 3; i++) {
        double here = out[i] + m->shift[i];
        if (held && !m->held) m->frozen[i] = here;
        if (held) here = m->frozen[i];
        if (!held && m->held) {
            m->shift[i] = fmin(fmax(m->frozen[i] - out[i], -m->reach), m->reach);
            here = out[i] + m->shift[i];
            /* Beyond its reach the clutch leaves the device elsewhere in the scene. */
            is_jump |= fabs(m->frozen[i] - out[i]) > m->reach;
        }
        out[i] = here;
    }
    if (!held && m->held) m->share_from = mailbox_now();
    if (is_jump) m->jumps++;
    m->held = held;
}

int device_read(int64_t context, int64_t seq, double *out) {
    mailbox *m = (mailbox *) (intptr_t) context;
    double sample[SAMPLE], place[3];
    (void) seq;
    /* Before the sample is taken, and also without one: what is decided now is no older. */
    m->decided_at = mailbox_now();
    int status = mailbox_sample(m, sample);
    if (status) return status;
    for (int i = 0; i < 3; i++) {
        place[i] = m->origin[i];
        for (int j = 0; j < 3; j++) place[i] += m->turn[3 * i + j] * sample[POSITION + j] * m->unit;
    }
    if (m->clutch) mailbox_clutch(m, sample, place);
    for (int i = 0; i < 3; i++) out[i] = place[i];
    if (m->told == m->jumps) return 0;
    m->told = m->jumps;
    return JUMPED;
}

int device_write(int64_t context, const double *force, int64_t seq, double offset) {
    mailbox *m = (mailbox *) (intptr_t) context;
    double theirs[COMMAND] = {0.0, 0.0, 0.0, m->decided_at}, share = 1.0;
    (void) seq;
    (void) offset;
    /* After the clutch was let go forces grow from zero: the hand is elsewhere now. */
    if (m->share_from != 0.0) share = m->back > 0.0 ? fmin((mailbox_now() - m->share_from) / m->back, 1.0) : 1.0;
    if (m->held) share = 0.0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) theirs[i] += m->turn[3 * j + i] * force[j] * share;
    }
    mailbox_put(&m->commands, m->force, theirs, COMMAND);
    return 0;
}

#endif
