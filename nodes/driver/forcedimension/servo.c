/* The servo loop of a Force Dimension device, in a thread of its own that needs neither Python nor its interpreter lock.

   A call of DHD that fails returns a negative number and leaves its out-parameters as they were; a positive number is a remark
   (time guard, a saturated motor), no error. So each call is judged by itself, and nothing is put that was not read. */

#include "../hardware/mailbox.h"

#include <pthread.h>
#include <signal.h>

#define STATUS 17
#define FORCE_OFF_CAUSE 14
#define STATUS_EVERY 20
#define JOINTS 8

typedef struct {
    mailbox box;
    /* Set before the start; what a device has not is null. */
    int (*get_position)(double *, double *, double *, char);
    int (*get_velocity)(double *, double *, double *, char);
    int (*get_orientation)(double[3][3], char);
    int (*get_gripper)(double *, char);
    unsigned int (*get_buttons)(char);
    int (*get_status)(int *, char);
    int (*set_force)(double, double, double, char);
    int (*last_error)(void);
    int (*get_joints)(double[8], char);
    double period;
    int device;
    int running;
    int saturated;
    unsigned int poses;
    double joints[JOINTS];
    pthread_t thread;
} servo;

size_t servo_size(void) { return sizeof(servo); }

static void orientation(double r[3][3], double *q) {
    q[3] = sqrt(fmax(0.0, 1.0 + r[0][0] + r[1][1] + r[2][2])) / 2.0;
    q[0] = copysign(sqrt(fmax(0.0, 1.0 + r[0][0] - r[1][1] - r[2][2])) / 2.0, r[2][1] - r[1][2]);
    q[1] = copysign(sqrt(fmax(0.0, 1.0 - r[0][0] + r[1][1] - r[2][2])) / 2.0, r[0][2] - r[2][0]);
    q[2] = copysign(sqrt(fmax(0.0, 1.0 - r[0][0] - r[1][1] + r[2][2])) / 2.0, r[1][0] - r[0][1]);
}

static void tick(servo *s, unsigned int n) {
    double sample[SAMPLE] = {NAN, NAN, NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0}, force[3], frame[3][3];
    char id = (char) s->device;
    int status[STATUS] = {0};
    int has_read = s->get_position(&sample[0], &sample[1], &sample[2], id) >= 0;
    if (!has_read) mailbox_failed(&s->box, s->last_error(), 0);
    if (s->get_velocity) s->get_velocity(&sample[VELOCITY], &sample[VELOCITY + 1], &sample[VELOCITY + 2], id);
    if (s->get_orientation && s->get_orientation(frame, id) >= 0) orientation(frame, sample + ORIENTATION);
    if (s->get_gripper) s->get_gripper(&sample[GRIPPER], id);
    if (s->get_buttons) sample[BUTTONS] = s->get_buttons(id);
    if (n % STATUS_EVERY == 0 && s->get_status(status, id) >= 0) {
        __atomic_store_n(&s->box.condition, status[FORCE_OFF_CAUSE], __ATOMIC_RELAXED);
    }
    double joints[JOINTS] = {0.0};
    if (n % STATUS_EVERY == 0 && s->get_joints && s->get_joints(joints, id) >= 0) {
        mailbox_put(&s->poses, s->joints, joints, JOINTS);
    }
    /* Without a position nothing is known of where a force acts. */
    mailbox_force(&s->box, force, !has_read);
    int done = s->set_force(force[0], force[1], force[2], id);
    if (done < 0) mailbox_failed(&s->box, s->last_error(), 0);
    if (done > 0) __atomic_add_fetch(&s->saturated, 1, __ATOMIC_RELAXED);
    if (has_read) {
        mailbox_sampled(&s->box, sample);
        mailbox_ticked(&s->box);
    }
}

static void *run(void *data) {
    servo *s = data;
    struct timespec next;
    unsigned int n = 0;
    clock_gettime(CLOCK_MONOTONIC, &next);
    while (!__atomic_load_n(&s->box.stop, __ATOMIC_ACQUIRE)) {
        tick(s, n++);
        next.tv_nsec += (long) (s->period * 1e9);
        while (next.tv_nsec >= 1000000000L) {
            next.tv_nsec -= 1000000000L;
            next.tv_sec++;
        }
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        if (now.tv_sec > next.tv_sec || (now.tv_sec == next.tv_sec && now.tv_nsec > next.tv_nsec)) next = now;
        else clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, 0);
    }
    return 0;
}

/* Take the joints' newest angles; whether there are any. */
int servo_joints(servo *s, double *joints) {
    for (int attempt = 0; attempt < 1000; attempt++) {
        if (mailbox_take(&s->poses, s->joints, joints, JOINTS)) return 1;
    }
    return 0;
}

/* Start the thread; signals are the node's. */
int servo_start(servo *s) {
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int failed = pthread_create(&s->thread, 0, run, s);
    pthread_sigmask(SIG_SETMASK, &before, 0);
    s->running = !failed;
    return failed;
}

/* End it; 0 once it has ended, which is waited for a second: a call of the device may hang. */
int servo_end(servo *s) {
    struct timespec until;
    if (!s->running) return 0;
    __atomic_store_n(&s->box.stop, 1, __ATOMIC_RELEASE);
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += 1;
    int failed = pthread_timedjoin_np(s->thread, 0, &until);
    if (!failed) s->running = 0;
    return failed;
}
