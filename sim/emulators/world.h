/* The arm behind a stand-in of a vendor's library, in a file that the library, a service and whoever plays the fault all map.

   A mass with a damper under gravity along each axis, moved exactly between two changes of force (as sim/device/model.py does); or
   held where `position` says until `free_from`. Here +x is forward, +y left, +z up, in SI units. */

#ifndef STAND_IN_WORLD_H
#define STAND_IN_WORLD_H

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#define LATE_FORCES 256

typedef struct {
    /* the arm */
    double mass, damping, gravity, resolution;
    double position[3], velocity[3], force[3], seen[3];
    double advanced_at, free_from;
    /* its own deadline [s], 0 for none, and when a force came last */
    double watchdog, commanded_at;
    /* what it bears */
    double peak, continuous;
    double gripper;
    double turn[9];
    int32_t buttons, serial, devices, rate;
    /* what the driver has done: the library is open, forces are on, calibrations left, rules broken, forces written, largest force */
    int32_t open, forces, calibrations, broken, commands, style;
    double largest;
    /* faults: see sim/emulators/world.py */
    int32_t unplugged, nan, positive, block_ms, manual, cause, error, refuse_rate, frozen, slow_ms, stuck, fails;
    double other[3];
    /* So long after it was given a force acts [s]; those on their way: when each acts, and it. */
    double late, due[LATE_FORCES][4];
    int32_t due_first, due_count;
    /* what a driver has told the library of weights: whether it carries the device's, the tool's mass, the base's angles */
    double tool_mass, base[2];
    int32_t carries, spare;
    char fail[32];
    int32_t lock; /* 0, or the process that holds it */
} world;

static inline double world_now(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (double) at.tv_sec + 1e-9 * (double) at.tv_nsec;
}

static inline void world_lock(world *w) {
    int32_t holder = 0, self = (int32_t) getpid();
    while (!__atomic_compare_exchange_n(&w->lock, &holder, self, 0, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED)) {
        /* Who is killed while it holds the lock never gives it back: it is taken from a process that is gone. */
        if (kill(holder, 0) && errno == ESRCH) continue;
        usleep(10);
        holder = 0;
    }
}

static inline void world_unlock(world *w) { __atomic_store_n(&w->lock, 0, __ATOMIC_RELEASE); }

static inline void world_step(world *w, double duration) {
    double q = w->damping > 0.0 ? -expm1(-w->damping * duration / w->mass) * w->mass / w->damping : duration;
    for (int i = 0; i < 3; i++) {
        double u = w->force[i] + w->other[i] - (i == 2 ? w->mass * w->gravity : 0.0);
        if (w->damping > 0.0) {
            double kept = 1.0 - q * w->damping / w->mass;
            w->position[i] += q * w->velocity[i] + u / w->damping * (duration - q);
            w->velocity[i] = kept * w->velocity[i] + u / w->damping * (1.0 - kept);
        } else {
            w->position[i] += duration * w->velocity[i] + 0.5 * u / w->mass * duration * duration;
            w->velocity[i] += u / w->mass * duration;
        }
    }
}

/* Let time pass up to now. */
static inline void world_advance(world *w) {
    double now = world_now(), ends = w->commanded_at + w->watchdog;
    double from = fmax(w->advanced_at, w->free_from);
    /* Without its cable a device has no power. */
    if (w->unplugged) w->force[0] = w->force[1] = w->force[2] = 0.0;
    if (w->watchdog > 0.0 && now > ends) {
        if (ends > from) world_step(w, ends - from);
        from = fmax(from, ends);
        w->force[0] = w->force[1] = w->force[2] = 0.0;
    }
    for (; w->due_count && w->due[w->due_first][0] <= now; w->due_count--) {
        const double *next = w->due[w->due_first];
        if (next[0] > from) {
            world_step(w, next[0] - from);
            from = next[0];
        }
        for (int i = 0; i < 3; i++) w->force[i] = next[1 + i];
        w->due_first = (w->due_first + 1) % LATE_FORCES;
    }
    if (now > from) world_step(w, now - from);
    w->advanced_at = now;
}

/* Read the encoders; 0 when the arm cannot be read, and nothing is written then. */
static inline int world_read(world *w, double *position, double *velocity) {
    int32_t block = __atomic_exchange_n(&w->block_ms, 0, __ATOMIC_SEQ_CST) + w->slow_ms;
    if (block) usleep(1000u * (unsigned) block);
    if (w->unplugged) return 0;
    world_lock(w);
    world_advance(w);
    for (int i = 0; i < 3; i++) {
        if (!w->stuck) w->seen[i] = w->position[i];
        double x = w->seen[i];
        if (w->resolution > 0.0) x = nearbyint(x / w->resolution) * w->resolution;
        position[i] = w->nan ? NAN : x;
        velocity[i] = w->velocity[i];
    }
    world_unlock(w);
    return 1;
}

/* Give it a force. */
static inline void world_push(world *w, const double *force) {
    world_lock(w);
    world_advance(w);
    w->commanded_at = world_now();
    w->commands++;
    double *late = w->due[(w->due_first + w->due_count) % LATE_FORCES];
    int is_late = w->late > 0.0 && w->due_count < LATE_FORCES;
    for (int i = 0; i < 3; i++) {
        if (!isfinite(force[i]) || fabs(force[i]) > w->peak) w->broken++;
        double given = w->forces && !w->cause && isfinite(force[i]) ? force[i] : 0.0;
        if (is_late) late[1 + i] = given;
        else w->force[i] = given;
        w->largest = fmax(w->largest, fabs(given));
    }
    if (is_late) {
        late[0] = w->commanded_at + w->late;
        w->due_count++;
    }
    world_unlock(w);
}

static inline world *world_at(const char *path) {
    int file = open(path, O_RDWR | O_CLOEXEC);
    if (file < 0) {
        fprintf(stderr, "stand-in: %s: no world there\n", path);
        abort();
    }
    void *at = mmap(0, sizeof(world), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (at == MAP_FAILED) abort();
    return at;
}

/* The world of a library lies beside its file. */
static inline world *world_of(void *function) {
    static world *found;
    Dl_info about;
    char path[4096];
    if (found) return found;
    if (!dladdr(function, &about)) abort();
    snprintf(path, sizeof(path), "%s.world", about.dli_fname);
    return found = world_at(path);
}

/* Whether a call is to fail now. */
static inline int world_fails(world *w, const char *call) { return w->unplugged || (w->fails && !strcmp(w->fail, call)); }

#endif
