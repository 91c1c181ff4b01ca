/* A stand-in for 3D Systems' libHD: as much of HDAPI as nodes/driver/touch uses, with a scheduler thread of its own.

   It holds a driver to HDAPI's rules: forces off during a calibration, frames in pairs, nothing after the end. What breaks a rule is
   counted. HDAPI's axes are right, up and towards the user, in millimetres. */

#include "world.h"

#include <pthread.h>

typedef struct {
    unsigned int error;
    int internal;
    unsigned int device;
} hd_error;

#define DEVICE 7u

static unsigned int errors[64];
static int error_count, in_frame, running;
static unsigned int current;
static pthread_t thread;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static unsigned int (*callback)(void *);
static void *callback_data;

static world *here(void) { return world_of((void *) here); }

static void broken(void) { __atomic_add_fetch(&here()->broken, 1, __ATOMIC_SEQ_CST); }

static void failed(unsigned int code) {
    pthread_mutex_lock(&lock);
    if (error_count < 64) errors[error_count++] = code;
    pthread_mutex_unlock(&lock);
}

/* Every call but hdGetError may fail; whether this one does. */
static int fails(const char *call) {
    if (!world_fails(here(), call)) return 0;
    failed(0x0302);
    return 1;
}

hd_error hdGetError(void) {
    hd_error found = {0, 0, 0};
    int wanted = __atomic_exchange_n(&here()->error, 0, __ATOMIC_SEQ_CST);
    if (wanted) failed((unsigned int) wanted);
    pthread_mutex_lock(&lock);
    if (error_count) {
        found.error = errors[0];
        memmove(errors, errors + 1, sizeof(errors[0]) * (size_t) --error_count);
    }
    pthread_mutex_unlock(&lock);
    return found;
}

unsigned int hdInitDevice(const char *name) {
    if (fails("hdInitDevice")) return 0xFFFFFFFFu;
    if (name && !strcmp(name, "absent")) {
        failed(0x0302);
        return 0xFFFFFFFFu;
    }
    here()->open++;
    current = DEVICE;
    return DEVICE;
}

void hdMakeCurrentDevice(unsigned int device) {
    if (device != DEVICE) broken();
    current = device;
}

void hdDisableDevice(unsigned int device) {
    if (device != DEVICE || !here()->open || running) broken();
    here()->open--;
}

void hdEnable(unsigned int what) {
    if (!fails("hdEnable") && what == 0x4000) here()->forces = 1;
}

void hdDisable(unsigned int what) {
    static const double zero[3];
    if (what == 0x4000) {
        here()->forces = 0;
        world_push(here(), zero);
    }
    fails("hdDisable");
}

void hdGetDoublev(unsigned int what, double *values) {
    world *w = here();
    double position[3], velocity[3];
    if (fails("hdGetDoublev")) return;
    switch (what) {
    case 0x2050:
    case 0x2051:
        if (!in_frame || current != DEVICE) broken();
        if (!world_read(w, position, velocity)) return failed(0x0302);
        const double *from = what == 0x2050 ? position : velocity;
        values[0] = -1e3 * from[1];
        values[1] = 1e3 * from[2];
        values[2] = -1e3 * from[0];
        break;
    case 0x2052: {
        /* Column by column; in the axes of HDAPI, which are ours turned. */
        memset(values, 0, 16 * sizeof(double));
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++) values[4 * j + i] = w->turn[3 * i + j];
        }
        values[15] = 1.0;
        break;
    }
    case 0x2550: {
        const double ends[6] = {-210.0, -110.0, -85.0, 210.0, 205.0, 130.0};
        memcpy(values, ends, sizeof(ends));
        break;
    }
    case 0x2603: values[0] = w->peak; break;
    case 0x2604: values[0] = w->continuous; break;
    default: failed(0x0100);
    }
}

void hdGetIntegerv(unsigned int what, int *values) {
    if (fails("hdGetIntegerv")) return;
    switch (what) {
    case 0x2000: values[0] = here()->buttons; break;
    case 0x2555: values[0] = 1 | 4; break;
    case 0x2600: values[0] = here()->rate; break;
    default: failed(0x0100);
    }
}

const char *hdGetString(unsigned int what) {
    static char serial[32];
    if (fails("hdGetString")) return 0;
    if (what == 0x2501) return "stand-in of a Touch X";
    if (what == 0x2502) return "0.0";
    if (what != 0x2504) {
        failed(0x0100);
        return 0;
    }
    snprintf(serial, sizeof(serial), "%d", here()->serial);
    return serial;
}

void hdSetDoublev(unsigned int what, const double *values) {
    if (what != 0x2700 || !in_frame || current != DEVICE) broken();
    if (fails("hdSetDoublev")) return;
    const double force[3] = {-values[2], -values[0], values[1]};
    world_push(here(), force);
}

void hdBeginFrame(unsigned int device) {
    if (device != DEVICE || in_frame++) broken();
}

void hdEndFrame(unsigned int device) {
    if (device != DEVICE || !in_frame--) broken();
}

void hdSetSchedulerRate(unsigned long wanted) {
    if (running) broken();
    if (fails("hdSetSchedulerRate")) return;
    if (here()->refuse_rate) failed(0x0101);
    else here()->rate = (int) wanted;
}

unsigned long hdScheduleAsynchronous(unsigned int (*function)(void *), void *data, unsigned short priority) {
    if (fails("hdScheduleAsynchronous")) return 0;
    if (priority != 65535) broken();
    callback = function;
    callback_data = data;
    return 3;
}

static void *run(void *nothing) {
    struct timespec next;
    (void) nothing;
    clock_gettime(CLOCK_MONOTONIC, &next);
    while (__atomic_load_n(&running, __ATOMIC_SEQ_CST)) {
        if (callback && !__atomic_load_n(&here()->frozen, __ATOMIC_SEQ_CST) && !callback(callback_data)) callback = 0;
        next.tv_nsec += 1000000000L / (here()->rate > 0 ? here()->rate : 1000);
        while (next.tv_nsec >= 1000000000L) {
            next.tv_nsec -= 1000000000L;
            next.tv_sec++;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, 0);
    }
    return 0;
}

void hdStartScheduler(void) {
    if (fails("hdStartScheduler")) return;
    __atomic_store_n(&running, 1, __ATOMIC_SEQ_CST);
    pthread_create(&thread, 0, run, 0);
}

void hdStopScheduler(void) {
    if (!__atomic_exchange_n(&running, 0, __ATOMIC_SEQ_CST)) return;
    pthread_join(thread, 0);
}

void hdUnschedule(unsigned long handle) {
    if (handle != 3 || running) broken();
    callback = 0;
}

unsigned int hdCheckCalibration(void) {
    if (fails("hdCheckCalibration")) return 0x5000;
    if (here()->manual) return 0x5002;
    return here()->calibrations ? 0x5001 : 0x5000;
}

void hdUpdateCalibration(unsigned int style) {
    if (fails("hdUpdateCalibration")) return;
    if (here()->forces) broken();
    here()->style = (int) style;
    if (here()->calibrations) here()->calibrations--;
}
