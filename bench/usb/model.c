/* A host controller and a board that always has a frame, behind the functions of libusb that
 * drivers/usb/transfers.py uses. The link carries one transfer after the other, each in the time of
 * its bytes; it waits when no read is submitted, and those waits are what is measured. No payload
 * is written, as a controller writes memory without the processor. */

#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <time.h>

enum { ENDS = 2, MOST_GAPS = 1 << 20, COMPLETED = 0, CANCELLED = 3, NOT_FOUND = -5 };

struct transfer { /* struct libusb_transfer without isochronous packets */
    void *handle;
    unsigned char flags, endpoint, type;
    unsigned timeout;
    int status, length, actual;
    void (*callback)(struct transfer *);
    void *user_data;
    unsigned char *buffer;
    int packets;
};

struct queued {
    struct transfer *transfer;
    long long submitted_ns;
    struct queued *next;
};

static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t work = PTHREAD_COND_INITIALIZER, done;
static struct queued *waiting, *returned;
static unsigned char header[ENDS][96];
static long long payload[ENDS], left[ENDS]; /* left: of the payload; -1: the header comes next */
static double bytes_per_ns;
static long long free_ns, total; /* when the link has carried what it has begun; bytes so far */
static double gaps_ms[MOST_GAPS];
static int gaps;
static pthread_t link_thread;
static int running;

static long long now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static struct timespec moment(long long at_ns) {
    return (struct timespec){at_ns / 1000000000LL, at_ns % 1000000000LL};
}

static void append(struct queued **list, struct queued *one) {
    one->next = NULL;
    while (*list) list = &(*list)->next;
    *list = one;
}

static void *carry(void *unused) {
    pthread_mutex_lock(&guard);
    while (running) {
        struct queued *one = waiting;
        if (!one) {
            pthread_cond_wait(&work, &guard);
            continue;
        }
        waiting = one->next;
        struct transfer *t = one->transfer;
        int end = (t->endpoint & 0x7f) - 1, heads = left[end] < 0;
        long long rest = heads ? (long long)sizeof header[end] : left[end];
        t->actual = rest < t->length ? (int)rest : t->length;
        if (heads) memcpy(t->buffer, header[end], t->actual);
        left[end] = heads ? payload[end] : left[end] - t->actual;
        if (!left[end]) left[end] = -1;
        long long begin_ns = one->submitted_ns > free_ns ? one->submitted_ns : free_ns;
        if (free_ns && gaps < MOST_GAPS) gaps_ms[gaps++] = (begin_ns - free_ns) / 1e6;
        free_ns = begin_ns + (long long)(t->actual / bytes_per_ns);
        total += t->actual;
        struct timespec at = moment(free_ns);
        pthread_mutex_unlock(&guard);
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) == EINTR) {}
        pthread_mutex_lock(&guard);
        t->status = COMPLETED;
        append(&returned, one);
        pthread_cond_signal(&done);
    }
    pthread_mutex_unlock(&guard);
    return unused;
}

/* what the bench calls */

void model_start(const unsigned char *headers, const long long *payloads, double bytes_per_s) {
    pthread_condattr_t clock;
    pthread_condattr_init(&clock);
    pthread_condattr_setclock(&clock, CLOCK_MONOTONIC);
    pthread_cond_init(&done, &clock);
    memcpy(header, headers, sizeof header);
    memcpy(payload, payloads, sizeof payload);
    for (int end = 0; end < ENDS; end++) left[end] = -1;
    bytes_per_ns = bytes_per_s / 1e9;
    free_ns = total = gaps = 0;
    running = 1;
    pthread_create(&link_thread, NULL, carry, NULL);
}

void model_stop(void) {
    pthread_mutex_lock(&guard);
    running = 0;
    pthread_cond_signal(&work);
    pthread_mutex_unlock(&guard);
    pthread_join(link_thread, NULL);
}

long long model_bytes(void) { return total; }
int model_gaps(const double **found) { *found = gaps_ms; return gaps; }

/* libusb */

struct transfer *libusb_alloc_transfer(int packets) {
    (void)packets;
    return calloc(1, sizeof(struct transfer));
}

void libusb_free_transfer(struct transfer *t) { free(t); }

int libusb_submit_transfer(struct transfer *t) {
    struct queued *one = malloc(sizeof *one);
    *one = (struct queued){t, now_ns(), NULL};
    pthread_mutex_lock(&guard);
    append(&waiting, one);
    pthread_cond_signal(&work);
    pthread_mutex_unlock(&guard);
    return 0;
}

int libusb_cancel_transfer(struct transfer *t) {
    int result = NOT_FOUND;
    pthread_mutex_lock(&guard);
    for (struct queued **at = &waiting; *at; at = &(*at)->next) {
        if ((*at)->transfer != t) continue;
        struct queued *one = *at;
        *at = one->next;
        t->status = CANCELLED;
        t->actual = 0;
        append(&returned, one);
        pthread_cond_signal(&done);
        result = 0;
        break;
    }
    pthread_mutex_unlock(&guard);
    return result;
}

int libusb_handle_events_timeout_completed(void *context, struct timeval *limit, int *completed) {
    (void)context;
    long long until_ns = now_ns() + limit->tv_sec * 1000000000LL + limit->tv_usec * 1000LL;
    struct timespec until = moment(until_ns);
    pthread_mutex_lock(&guard);
    while (!returned && !*completed)
        if (pthread_cond_timedwait(&done, &guard, &until) == ETIMEDOUT) break;
    struct queued *one;
    while ((one = returned)) {
        returned = one->next;
        pthread_mutex_unlock(&guard);
        struct transfer *t = one->transfer;
        free(one);
        t->callback(t);
        pthread_mutex_lock(&guard);
    }
    pthread_mutex_unlock(&guard);
    return 0;
}
