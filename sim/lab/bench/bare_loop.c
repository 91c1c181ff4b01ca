/* The floor: the same three hops in C, on pyzmq's own libzmq, with a struct of 72 bytes in place of a message.

   Same sockets and roles as bare_loop.py, unchecked, uncounted and unrecorded. The wheel brings no zmq.h, so the few functions
   are declared here and found in the library that is named:

       bare_loop LIBZMQ ROLE FOLDER TICKS CORE FIFO RATE LISTENERS
*/
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { SUB = 2, XPUB = 9, SUBSCRIBE = 6, LINGER = 17, RECONNECT_IVL = 18, RCVTIMEO = 27, SNDHWM = 23, XPUB_VERBOSE = 40, SNDMORE = 2 };

static void *(*ctx_new)(void);
static int (*ctx_term)(void *);
static void *(*new_socket)(void *, int);
static int (*close_socket)(void *);
static int (*set_option)(void *, int, const void *, size_t);
static int (*bind_to)(void *, const char *);
static int (*connect_to)(void *, const char *);
static int (*send_frame)(void *, const void *, size_t, int);
static int (*recv_frame)(void *, void *, size_t, int);

typedef struct {
    int64_t seq;
    double stamp, position[3], force[3], distance;
} message;

static void *context, *publisher, *inbox;
static const char *topic;

static void *find(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "%s: not in libzmq\n", name);
        exit(2);
    }
    return found;
}

static void load(const char *path) {
    void *library = dlopen(path, RTLD_NOW);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        exit(2);
    }
    *(void **)&ctx_new = find(library, "zmq_ctx_new");
    *(void **)&ctx_term = find(library, "zmq_ctx_term");
    *(void **)&new_socket = find(library, "zmq_socket");
    *(void **)&close_socket = find(library, "zmq_close");
    *(void **)&set_option = find(library, "zmq_setsockopt");
    *(void **)&bind_to = find(library, "zmq_bind");
    *(void **)&connect_to = find(library, "zmq_connect");
    *(void **)&send_frame = find(library, "zmq_send");
    *(void **)&recv_frame = find(library, "zmq_recv");
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec * 1e-9;
}

static void *subscriber(const char *folder, const char *to) {
    char place[256];
    int often = 10;
    void *socket = new_socket(context, SUB);
    set_option(socket, RECONNECT_IVL, &often, sizeof often);
    snprintf(place, sizeof place, "ipc://%s/%s", folder, to);
    connect_to(socket, place);
    set_option(socket, SUBSCRIBE, "", 0);
    return socket;
}

static void open_sockets(const char *folder, const char *own, const char *other, int listeners) {
    char place[256], frame[16];
    publisher = new_socket(context, XPUB);
    int verbose = 1, queue = 4096;
    set_option(publisher, XPUB_VERBOSE, &verbose, sizeof verbose);
    set_option(publisher, SNDHWM, &queue, sizeof queue);
    snprintf(place, sizeof place, "ipc://%s/%s", folder, own);
    bind_to(publisher, place);
    inbox = subscriber(folder, other);
    /* The subscriptions of those who listen: from here on nothing is lost. */
    for (int k = 0; k < 1 + listeners; k++)
        recv_frame(publisher, frame, sizeof frame, 0);
}

static void publish(const message *m) {
    send_frame(publisher, topic, strlen(topic), SNDMORE);
    send_frame(publisher, m, sizeof *m, 0);
}

static int receive(message *m) {
    char frame[64];
    if (recv_frame(inbox, frame, sizeof frame, 0) < 0)
        return 0;
    return recv_frame(inbox, m, sizeof *m, 0) == (int)sizeof *m;
}

static void close_sockets(void) {
    int linger = 1000, none = 0;
    set_option(publisher, LINGER, &linger, sizeof linger);
    set_option(inbox, LINGER, &none, sizeof none);
    close_socket(publisher);
    close_socket(inbox);
    ctx_term(context);
}

static void relay(int coupling) {
    message m;
    do {
        if (!receive(&m))
            continue;
        if (coupling)
            m.force[2] = m.distance < 0.0 ? -1000.0 * m.distance : 0.0;
        else
            m.distance = m.position[2];
        publish(&m);
    } while (m.seq >= 0);
    close_sockets();
}

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void drive(long ticks, double rate) {
    message m = {0, 0.0, {0.0, 0.0, 0.01}, {0}, 0.0}, answer;
    double *responses = calloc(ticks, sizeof *responses), due = 0.0;
    long missed = 0;
    int wait = 50, none = -1;
    /* The inbox's own subscription has to reach the coupling too: the first tick is asked until it is answered. */
    set_option(inbox, RCVTIMEO, &wait, sizeof wait);
    do
        publish(&m);
    while (!receive(&answer));
    while (receive(&answer))
        ;
    set_option(inbox, RCVTIMEO, &none, sizeof none);
    double begun = now();
    for (long k = 1; k <= ticks; k++) {
        if (rate > 0.0) {
            due = begun + k / rate;
            struct timespec until = {(time_t)due, (long)((due - (time_t)due) * 1e9)};
            while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL))
                ;
        }
        m.seq = k;
        double sent = m.stamp = now();
        publish(&m);
        do
            receive(&answer);
        while (answer.seq != k);
        m.position[2] += 1e-9 * answer.force[2];
        double arrived = now();
        responses[k - 1] = arrived - sent;
        missed += rate > 0.0 && arrived > due + 1.0 / rate;
    }
    double elapsed = now() - begun;
    m.seq = -1;
    publish(&m);
    receive(&answer);
    qsort(responses, ticks, sizeof *responses, by_size);
    double share[] = {0.5, 0.99, 0.999, 1.0}, at[4];
    for (int k = 0; k < 4; k++) {
        long place = share[k] * ticks;
        at[k] = 1e6 * responses[place < ticks ? place : ticks - 1];
    }
    printf("{\"ticks\": %ld, \"ticks_per_s\": %.1f, \"missed\": %ld, \"response_us\": {\"p50\": %.1f, \"p99\": %.1f, "
           "\"p999\": %.1f, \"max\": %.1f}}\n",
           ticks, ticks / elapsed, missed, at[0], at[1], at[2], at[3]);
    close_sockets();
}

static void log_all(const char *folder) {
    static const char *const names[] = {"driver", "environment", "coupling"};
    inbox = subscriber(folder, names[0]);
    for (int k = 1; k < 3; k++) {
        char place[256];
        snprintf(place, sizeof place, "ipc://%s/%s", folder, names[k]);
        connect_to(inbox, place);
    }
    message m;
    int ends = receive(&m) && m.seq < 0, silence = 1000;
    /* Until each has said its last, or a second of silence: a last word may be dropped. */
    set_option(inbox, RCVTIMEO, &silence, sizeof silence);
    while (ends < 3 && receive(&m))
        ends += m.seq < 0;
    close_socket(inbox);
    ctx_term(context);
}

int main(int count, char **words) {
    if (count != 9)
        return 2;
    const char *role = words[2], *folder = words[3];
    long ticks = atol(words[4]);
    int fifo = atoi(words[6]), listeners = atoi(words[8]);
    if (strcmp(words[5], "any")) {
        cpu_set_t cores;
        CPU_ZERO(&cores);
        CPU_SET(atoi(words[5]), &cores);
        sched_setaffinity(0, sizeof cores, &cores);
    }
    if (fifo) {
        struct sched_param urgency = {fifo};
        sched_setscheduler(0, SCHED_FIFO, &urgency);
    }
    load(words[1]);
    context = ctx_new();
    topic = role;
    if (!strcmp(role, "logger")) {
        log_all(folder);
    } else if (!strcmp(role, "environment")) {
        open_sockets(folder, "environment", "driver", listeners);
        relay(0);
    } else if (!strcmp(role, "coupling")) {
        open_sockets(folder, "coupling", "environment", listeners);
        relay(1);
    } else {
        open_sockets(folder, "driver", "coupling", listeners);
        drive(ticks, atof(words[7]));
    }
    return 0;
}
