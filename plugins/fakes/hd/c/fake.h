/* What the parts of the fake HD library share. */
#ifndef FAKE_H
#define FAKE_H

#include <pthread.h>
#include <stddef.h>

#include "hd_abi.h"

#define MAX_DEVICES 8
#define MAX_FORCES 65536
#define MAX_LOG 8192
#define NAME 64

struct vec { double x[3]; };

/* A force as it reached the motors. */
struct force_record {
    double time; /* s since the library was loaded */
    struct vec force, torque;
};

struct fake_device {
    char name[NAME], model[NAME];
    int initialised, in_frame;
    int output, clamping;
    HDenum calibration;
    int styles;
    /* The hand: where it wants the tip, mm; a spring and damper pull a mass there, or the tip is there if the mass is 0. */
    struct vec centre;
    double radius, frequency, mass, stiffness, damping;
    struct vec position, velocity; /* mm, mm/s */
    double rotation[9];            /* by columns */
    double last_frame;             /* s */
    struct vec joints, gimbal;
    int buttons;
    /* State as it was when the frame began, and in the frame before. */
    double transform[2][16];
    struct vec seen_position[2], seen_velocity[2];
    /* What this frame sets. */
    struct vec force, torque;
    struct vec sent;
    /* Faults. */
    int fail_init, fault, comm_frames, warm_frames, stolen_frames;
    struct force_record *forces;
    size_t force_count;
};

/* Guards everything below; held for moments only, never while a callback runs. */
extern pthread_mutex_t fake_lock;
extern struct fake_device fake_devices[MAX_DEVICES];
extern int fake_device_count;
/* Whether the current device is one for the process rather than one for each thread. */
extern int fake_current_is_shared;

double fake_time(void);
void fake_error(uint32_t code, HHD device);
void fake_log(const char *format, ...) __attribute__((format(printf, 1, 2)));
size_t fake_read_log(char *text, size_t size);
struct fake_device *fake_find(const char *name);
struct fake_device *fake_add(const char *name, const char *model);
/* Closes frames that a tick has left open, with an error each. */
void fake_end_of_tick(void);
/* The scheduler stands still for so long, s. */
void fake_stall(double seconds);
/* The scheduler tells every callback an error. */
void fake_scheduler_error(uint32_t code);

#endif
