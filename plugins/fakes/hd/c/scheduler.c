/* Scheduler of the fake HD library: a thread that calls callbacks by priority, 1000 times a second. */
#define _GNU_SOURCE
#include <string.h>
#include <time.h>

#include "fake.h"

#define MAX_CALLBACKS 32

struct entry {
    HDSchedulerHandle handle; /* 0: free */
    HDSchedulerCallback callback;
    void *user;
    HDushort priority;
    int running;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;
static struct entry entries[MAX_CALLBACKS];
static HDSchedulerHandle next_handle = 1;
static pthread_t thread;
static int running;
static HDulong rate = 1000;
static double tick_start;
/* Set while the lock of the devices is held, so not under the lock of this file. */
static _Atomic double stall;
static _Atomic uint32_t pending_error;
static __thread int is_scheduler;

void fake_stall(double seconds)
{
    stall = seconds;
}

void fake_scheduler_error(uint32_t code)
{
    pending_error = code;
}

static struct entry *find(HDSchedulerHandle handle)
{
    for (int i = 0; handle && i < MAX_CALLBACKS; i++)
        if (entries[i].handle == handle)
            return &entries[i];
    return NULL;
}

static void log_event(const char *what)
{
    pthread_mutex_lock(&fake_lock);
    fake_log("%s", what);
    pthread_mutex_unlock(&fake_lock);
}

/* Calls every callback once, the highest priority first. The lock is held, but not during a callback. */
static void tick(void)
{
    HDSchedulerHandle order[MAX_CALLBACKS];
    HDushort priorities[MAX_CALLBACKS];
    int count = 0;
    for (int i = 0; i < MAX_CALLBACKS; i++) {
        if (!entries[i].handle)
            continue;
        int at = count++;
        for (; at > 0 && priorities[at - 1] < entries[i].priority; at--) {
            order[at] = order[at - 1];
            priorities[at] = priorities[at - 1];
        }
        order[at] = entries[i].handle;
        priorities[at] = entries[i].priority;
    }
    tick_start = fake_time();
    uint32_t error = pending_error;
    pending_error = 0;
    for (int i = 0; i < count; i++) {
        struct entry *entry = find(order[i]);
        if (!entry)
            continue;
        HDSchedulerCallback callback = entry->callback;
        void *user = entry->user;
        entry->running = 1;
        pthread_mutex_unlock(&lock);
        if (error)
            fake_error(error, HD_INVALID_HANDLE);
        uint32_t code = callback(user);
        fake_end_of_tick();
        pthread_mutex_lock(&lock);
        entry->running = 0;
        if (code != HD_CALLBACK_CONTINUE && entry->handle == order[i]) {
            entry->handle = 0;
            log_event("done");
        }
        pthread_cond_broadcast(&changed);
    }
}

static void *run(void *unused)
{
    (void)unused;
    struct timespec next;
    is_scheduler = 1;
    clock_gettime(CLOCK_MONOTONIC, &next);
    pthread_mutex_lock(&lock);
    while (running) {
        double pause = stall;
        stall = 0.0;
        if (pause > 0.0) {
            pthread_mutex_unlock(&lock);
            struct timespec still = { (time_t)pause, (long)((pause - (double)(time_t)pause) * 1e9) };
            nanosleep(&still, NULL);
            clock_gettime(CLOCK_MONOTONIC, &next);
            pthread_mutex_lock(&lock);
        }
        tick();
        next.tv_nsec += 1000000000L / (long)rate;
        if (next.tv_nsec >= 1000000000L) {
            next.tv_nsec -= 1000000000L;
            next.tv_sec++;
        }
        pthread_mutex_unlock(&lock);
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        pthread_mutex_lock(&lock);
    }
    pthread_mutex_unlock(&lock);
    return NULL;
}

void hdStartScheduler(void)
{
    pthread_mutex_lock(&lock);
    if (running) {
        fake_error(HD_INVALID_OPERATION, HD_INVALID_HANDLE);
    } else {
        running = 1;
        log_event("start");
        if (pthread_create(&thread, NULL, run, NULL) != 0) {
            running = 0;
            fake_error(HD_TIMER_ERROR, HD_INVALID_HANDLE);
        }
    }
    pthread_mutex_unlock(&lock);
}

void hdStopScheduler(void)
{
    pthread_mutex_lock(&lock);
    int stop = running;
    running = 0;
    if (stop)
        log_event("stop");
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&lock);
    if (stop && !is_scheduler)
        pthread_join(thread, NULL);
}

void hdSetSchedulerRate(HDulong asked)
{
    pthread_mutex_lock(&lock);
    if (asked == 500 || asked == 1000 || asked == 2000)
        rate = asked;
    else
        fake_error(HD_INVALID_VALUE, HD_INVALID_HANDLE);
    pthread_mutex_unlock(&lock);
}

static HDSchedulerHandle add(HDSchedulerCallback callback, void *user, HDushort priority)
{
    for (int i = 0; i < MAX_CALLBACKS; i++)
        if (!entries[i].handle && !entries[i].running) {
            struct entry entry = { next_handle++, callback, user, priority, 0 };
            entries[i] = entry;
            return entry.handle;
        }
    fake_error(HD_SCHEDULER_FULL, HD_INVALID_HANDLE);
    return 0;
}

HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback callback, void *user, HDushort priority)
{
    pthread_mutex_lock(&lock);
    HDSchedulerHandle handle = add(callback, user, priority);
    pthread_mutex_unlock(&lock);
    return handle;
}

void hdScheduleSynchronous(HDSchedulerCallback callback, void *user, HDushort priority)
{
    if (is_scheduler) {
        while (callback(user) == HD_CALLBACK_CONTINUE)
            ;
        return;
    }
    pthread_mutex_lock(&lock);
    if (!running) {
        fake_error(HD_INVALID_OPERATION, HD_INVALID_HANDLE);
    } else {
        HDSchedulerHandle handle = add(callback, user, priority);
        while (running && find(handle))
            pthread_cond_wait(&changed, &lock);
    }
    pthread_mutex_unlock(&lock);
}

void hdUnschedule(HDSchedulerHandle handle)
{
    pthread_mutex_lock(&lock);
    struct entry *entry = find(handle);
    if (entry) {
        entry->handle = 0;
        log_event("unschedule");
        while (entry->running && !is_scheduler)
            pthread_cond_wait(&changed, &lock);
        pthread_cond_broadcast(&changed);
    } else {
        fake_error(HD_INVALID_VALUE, HD_INVALID_HANDLE);
    }
    pthread_mutex_unlock(&lock);
}

HDboolean hdWaitForCompletion(HDSchedulerHandle handle, uint32_t code)
{
    pthread_mutex_lock(&lock);
    while (code == HD_WAIT_INFINITE && running && find(handle))
        pthread_cond_wait(&changed, &lock);
    HDboolean scheduled = find(handle) != NULL;
    pthread_mutex_unlock(&lock);
    return scheduled;
}

double hdGetSchedulerTimeStamp(void)
{
    pthread_mutex_lock(&lock);
    double elapsed = fake_time() - tick_start;
    pthread_mutex_unlock(&lock);
    return elapsed;
}
