/* Devices of the fake HD library: handles, frames, values, errors. */
#define _GNU_SOURCE
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fake.h"

pthread_mutex_t fake_lock = PTHREAD_MUTEX_INITIALIZER;
struct fake_device fake_devices[MAX_DEVICES];
int fake_device_count;
int fake_current_is_shared;

static __thread HHD thread_current = HD_INVALID_HANDLE;
static HHD process_current = HD_INVALID_HANDLE;

#define MAX_ERRORS 64
static __thread HDErrorInfo errors[MAX_ERRORS];
static __thread int error_count;

static char log_text[MAX_LOG];
static size_t log_length;

double fake_time(void)
{
    static double start;
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    double time = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
    if (start == 0.0)
        start = time;
    return time - start;
}

void fake_error(uint32_t code, HHD device)
{
    if (error_count == MAX_ERRORS) {
        memmove(errors, errors + 1, sizeof errors - sizeof errors[0]);
        error_count--;
    }
    HDErrorInfo error = { code, -(int32_t)code, device };
    errors[error_count++] = error;
}

void fake_log(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(log_text + log_length, MAX_LOG - log_length, format, arguments);
    va_end(arguments);
    if (length > 0 && log_length + (size_t)length + 1 < MAX_LOG) {
        log_length += (size_t)length;
        log_text[log_length++] = '\n';
    }
    log_text[log_length] = 0;
}

size_t fake_read_log(char *text, size_t size)
{
    snprintf(text, size, "%s", log_text);
    return log_length;
}

static HHD *current(void)
{
    return fake_current_is_shared ? &process_current : &thread_current;
}

static struct fake_device *device_of(HHD handle)
{
    if (handle >= (HHD)fake_device_count || !fake_devices[handle].initialised)
        return NULL;
    return &fake_devices[handle];
}

/* The current device, or an error. */
static struct fake_device *current_device(void)
{
    struct fake_device *device = device_of(*current());
    if (!device)
        fake_error(HD_BAD_HANDLE, *current());
    return device;
}

struct fake_device *fake_find(const char *name)
{
    for (int i = 0; i < fake_device_count; i++)
        if (strcmp(fake_devices[i].name, name) == 0)
            return &fake_devices[i];
    return NULL;
}

struct fake_device *fake_add(const char *name, const char *model)
{
    struct fake_device *device = fake_find(name);
    if (!device) {
        if (fake_device_count == MAX_DEVICES)
            return NULL;
        device = &fake_devices[fake_device_count++];
        memset(device, 0, sizeof *device);
        device->forces = calloc(MAX_FORCES, sizeof *device->forces);
        device->calibration = HD_CALIBRATION_OK;
        device->styles = HD_CALIBRATION_AUTO | HD_CALIBRATION_INKWELL;
        device->rotation[0] = device->rotation[4] = device->rotation[8] = 1.0;
        device->stiffness = 100.0;
        device->damping = 4.0;
        device->clamping = 1;
        snprintf(device->name, NAME, "%s", name);
    }
    snprintf(device->model, NAME, "%s", model);
    return device;
}

/* Where the hand wants the tip, mm, mm/s. */
static void script(const struct fake_device *device, double time, struct vec *position, struct vec *velocity)
{
    double w = 2.0 * M_PI * device->frequency, a = w * time, r = device->radius;
    *position = device->centre;
    position->x[0] += r * sin(a);
    position->x[1] += r * (cos(a) - 1.0);
    velocity->x[0] = r * w * cos(a);
    velocity->x[1] = -r * w * sin(a);
    velocity->x[2] = 0.0;
}

/* Moves the tip to where it is now. */
static void move(struct fake_device *device)
{
    struct vec target, speed;
    double now = fake_time(), left = now - device->last_frame;
    script(device, now, &target, &speed);
    if (device->mass <= 0.0 || device->last_frame == 0.0 || left > 0.1) {
        device->position = target;
        device->velocity = speed;
    } else {
        while (left > 0.0) {
            double dt = left < 2e-4 ? left : 2e-4;
            for (int i = 0; i < 3; i++) {
                double pull = device->stiffness * (target.x[i] - device->position.x[i]) * 1e-3
                    + device->damping * (speed.x[i] - device->velocity.x[i]) * 1e-3;
                device->velocity.x[i] += (pull + device->sent.x[i]) / device->mass * dt * 1e3;
                device->position.x[i] += device->velocity.x[i] * dt;
            }
            left -= dt;
        }
    }
    device->last_frame = now;
}

HHD hdInitDevice(const char *name)
{
    HHD handle = HD_INVALID_HANDLE;
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = fake_find(name ? name : "Default Device");
    if (!device || device->fail_init || device->fault) {
        fake_error(HD_COMM_ERROR, HD_INVALID_HANDLE);
    } else if (device->initialised) {
        fake_error(HD_DEVICE_ALREADY_INITIATED, HD_INVALID_HANDLE);
    } else {
        handle = (HHD)(device - fake_devices);
        device->initialised = 1;
        device->in_frame = device->output = 0;
        device->clamping = 1;
        device->last_frame = 0.0;
        *current() = handle;
        fake_log("init %s", device->name);
    }
    pthread_mutex_unlock(&fake_lock);
    return handle;
}

void hdDisableDevice(HHD handle)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = device_of(handle);
    if (device) {
        device->initialised = 0;
        fake_log("disable %s", device->name);
    } else {
        fake_error(HD_BAD_HANDLE, handle);
    }
    pthread_mutex_unlock(&fake_lock);
}

void hdMakeCurrentDevice(HHD handle)
{
    pthread_mutex_lock(&fake_lock);
    if (device_of(handle))
        *current() = handle;
    else
        fake_error(HD_BAD_HANDLE, handle);
    pthread_mutex_unlock(&fake_lock);
}

HHD hdGetCurrentDevice(void)
{
    pthread_mutex_lock(&fake_lock);
    HHD handle = *current();
    pthread_mutex_unlock(&fake_lock);
    return handle;
}

/* Another device becomes current behind the caller's back, as when a second thread initialises one. */
static void steal_current(struct fake_device *device)
{
    for (int i = 0; i < fake_device_count; i++)
        if (&fake_devices[i] != device && fake_devices[i].initialised)
            *current() = (HHD)i;
}

void hdBeginFrame(HHD handle)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = device_of(handle);
    if (!device) {
        fake_error(HD_BAD_HANDLE, handle);
    } else if (device->in_frame) {
        fake_error(HD_ILLEGAL_BEGIN, handle);
    } else {
        device->in_frame = 1;
        memset(&device->force, 0, sizeof device->force);
        memset(&device->torque, 0, sizeof device->torque);
        if (device->fault)
            fake_error(HD_DEVICE_FAULT, handle);
        if (device->comm_frames > 0) {
            device->comm_frames--;
            fake_error(HD_COMM_ERROR, handle);
        }
        memcpy(device->transform[1], device->transform[0], sizeof device->transform[0]);
        device->seen_position[1] = device->seen_position[0];
        device->seen_velocity[1] = device->seen_velocity[0];
        move(device);
        device->seen_position[0] = device->position;
        device->seen_velocity[0] = device->velocity;
        double *m = device->transform[0];
        memset(m, 0, sizeof device->transform[0]);
        for (int j = 0; j < 3; j++)
            for (int i = 0; i < 3; i++) /* slightly off, as the vendor's is */
                m[4 * j + i] = device->rotation[3 * j + i] + 1e-4 * ((i + 2 * j) % 3 - 1);
        for (int i = 0; i < 3; i++)
            m[12 + i] = device->position.x[i];
        m[15] = 1.0;
        if (device->stolen_frames > 0) {
            device->stolen_frames--;
            steal_current(device);
        }
    }
    pthread_mutex_unlock(&fake_lock);
}

void hdEndFrame(HHD handle)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = device_of(handle);
    if (!device) {
        fake_error(HD_BAD_HANDLE, handle);
    } else if (!device->in_frame) {
        fake_error(HD_ILLEGAL_END, handle);
    } else {
        struct force_record record = { fake_time(), device->force, device->torque };
        double norm = sqrt(record.force.x[0] * record.force.x[0] + record.force.x[1] * record.force.x[1]
            + record.force.x[2] * record.force.x[2]);
        device->in_frame = 0;
        if (norm > 3.3 + 1e-9) {
            fake_error(HD_EXCEEDED_MAX_FORCE, handle);
            for (int i = 0; i < 3; i++)
                record.force.x[i] *= 3.3 / norm;
        }
        if (device->warm_frames > 0) {
            device->warm_frames--;
            fake_error(HD_WARM_MOTORS, handle);
        }
        if (!device->output || device->fault) {
            memset(&record.force, 0, sizeof record.force);
            memset(&record.torque, 0, sizeof record.torque);
        }
        device->sent = record.force;
        device->forces[device->force_count++ % MAX_FORCES] = record;
    }
    pthread_mutex_unlock(&fake_lock);
}

void fake_end_of_tick(void)
{
    pthread_mutex_lock(&fake_lock);
    for (int i = 0; i < fake_device_count; i++)
        if (fake_devices[i].in_frame) {
            fake_devices[i].in_frame = 0;
            memset(&fake_devices[i].sent, 0, sizeof fake_devices[i].sent);
            fake_error(HD_FRAME_ERROR, (HHD)i);
        }
    pthread_mutex_unlock(&fake_lock);
}

HDErrorInfo hdGetError(void)
{
    HDErrorInfo none = { HD_SUCCESS, 0, HD_INVALID_HANDLE };
    return error_count > 0 ? errors[--error_count] : none;
}

const char *hdGetErrorString(uint32_t code)
{
    switch (code >> 8) {
    case 0: return "no error";
    case 1: return "invalid argument";
    case 2: return "force error";
    case 3: return "device error";
    case 4: return "frame error";
    case 5: return "scheduler error";
    default: return "unknown error";
    }
}

static void set_capability(HDenum capability, int on)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    if (device) {
        if (capability == HD_FORCE_OUTPUT)
            device->output = on;
        else if (capability == HD_MAX_FORCE_CLAMPING)
            device->clamping = on;
        else
            fake_error(HD_INVALID_ENUM, *current());
        fake_log("%s %s %04x", on ? "enable" : "disable", device->name, capability);
    }
    pthread_mutex_unlock(&fake_lock);
}

void hdEnable(HDenum capability) { set_capability(capability, 1); }
void hdDisable(HDenum capability) { set_capability(capability, 0); }

HDboolean hdIsEnabled(HDenum capability)
{
    HDboolean enabled = 0;
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    if (device && capability == HD_FORCE_OUTPUT)
        enabled = device->output != 0;
    else if (device && capability == HD_MAX_FORCE_CLAMPING)
        enabled = device->clamping != 0;
    else if (device)
        fake_error(HD_INVALID_ENUM, *current());
    pthread_mutex_unlock(&fake_lock);
    return enabled;
}

/* Values of the current device as doubles; gives back how many, 0 for none. Holds the lock. */
static int values_of(HDenum name, double *values)
{
    struct fake_device *device = current_device();
    if (!device)
        return 0;
    int last = (name & 0xFF00) == 0x2200 || (name & 0xFF00) == 0x2300;
    HDenum current_name = last ? name - HD_LAST_OFFSET : name;
    const struct vec *vector = NULL;
    if ((current_name >= 0x2000 && current_name < 0x2200) && !device->in_frame) {
        fake_error(HD_FRAME_ERROR, *current());
        return 0;
    }
    switch (current_name) {
    case HD_CURRENT_BUTTONS: values[0] = device->buttons; return 1;
    case HD_CURRENT_SAFETY_SWITCH: values[0] = 0; return 1;
    case HD_CURRENT_INKWELL_SWITCH: values[0] = device->calibration == HD_CALIBRATION_NEEDS_UPDATE; return 1;
    case HD_CURRENT_ENCODER_VALUES:
        for (int i = 0; i < 3; i++) {
            values[i] = floor(device->joints.x[i] * 1000.0);
            values[i + 3] = floor(device->gimbal.x[i] * 1000.0);
        }
        return 6;
    case HD_CURRENT_TRANSFORM: memcpy(values, device->transform[last], sizeof device->transform[0]); return 16;
    case HD_CURRENT_POSITION: vector = &device->seen_position[last]; break;
    case HD_CURRENT_VELOCITY: vector = &device->seen_velocity[last]; break;
    case HD_CURRENT_JOINT_ANGLES: vector = &device->joints; break;
    case HD_CURRENT_GIMBAL_ANGLES: vector = &device->gimbal; break;
    case HD_CURRENT_FORCE: vector = &device->force; break;
    case HD_CURRENT_TORQUE: vector = &device->torque; break;
    case HD_MAX_WORKSPACE_DIMENSIONS:
    case HD_USABLE_WORKSPACE_DIMENSIONS: {
        const double box[6] = { -80, -60, -35, 80, 60, 35 };
        memcpy(values, box, sizeof box);
        return 6;
    }
    case HD_INPUT_DOF: values[0] = 6; return 1;
    case HD_OUTPUT_DOF: values[0] = 3; return 1;
    case HD_CALIBRATION_STYLE: values[0] = device->styles; return 1;
    case HD_UPDATE_RATE:
    case HD_INSTANTANEOUS_UPDATE_RATE: values[0] = 1000; return 1;
    case HD_NOMINAL_MAX_STIFFNESS: values[0] = 0.4; return 1;
    case HD_NOMINAL_MAX_FORCE: values[0] = 3.3; return 1;
    case HD_NOMINAL_MAX_CONTINUOUS_FORCE: values[0] = 0.88; return 1;
    default: fake_error(HD_INVALID_ENUM, *current()); return 0;
    }
    memcpy(values, vector, sizeof *vector);
    return 3;
}

#define GETTER(function, type)                       \
    void function(HDenum name, type *values)         \
    {                                                \
        double all[16];                              \
        pthread_mutex_lock(&fake_lock);              \
        int count = values_of(name, all);            \
        pthread_mutex_unlock(&fake_lock);            \
        for (int i = 0; i < count; i++)              \
            values[i] = (type)all[i];                \
    }

GETTER(hdGetBooleanv, HDboolean)
GETTER(hdGetIntegerv, int32_t)
GETTER(hdGetFloatv, float)
GETTER(hdGetDoublev, double)
GETTER(hdGetLongv, int64_t)

const char *hdGetString(HDenum name)
{
    const char *text = "";
    static __thread char serial[NAME];
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    if (device) {
        switch (name) {
        case HD_VERSION: text = "3.0.66 fake"; break;
        case HD_DEVICE_MODEL_TYPE: text = device->model; break;
        case HD_DEVICE_DRIVER_VERSION: text = "fake"; break;
        case HD_DEVICE_VENDOR: text = "Nobody Inc."; break;
        case HD_DEVICE_SERIAL_NUMBER:
            snprintf(serial, sizeof serial, "FAKE%04d", (int)(device - fake_devices));
            text = serial;
            break;
        case HD_DEVICE_FIRMWARE_VERSION: text = "1"; break;
        default: fake_error(HD_INVALID_ENUM, *current());
        }
    }
    pthread_mutex_unlock(&fake_lock);
    return text;
}

static void set_values(HDenum name, const double *values)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    if (device && name != HD_CURRENT_FORCE && name != HD_CURRENT_TORQUE)
        fake_error(HD_INVALID_ENUM, *current());
    else if (device && !device->in_frame)
        fake_error(HD_FRAME_ERROR, *current());
    else if (device)
        memcpy(name == HD_CURRENT_FORCE ? &device->force : &device->torque, values, sizeof device->force);
    pthread_mutex_unlock(&fake_lock);
}

void hdSetDoublev(HDenum name, const double *values) { set_values(name, values); }

void hdSetFloatv(HDenum name, const float *values)
{
    double all[3] = { values[0], values[1], values[2] };
    set_values(name, all);
}

/* Forces are not of these types. */
void hdSetBooleanv(HDenum name, const HDboolean *values) { (void)name, (void)values, fake_error(HD_INVALID_INPUT_TYPE, hdGetCurrentDevice()); }
void hdSetIntegerv(HDenum name, const int32_t *values) { (void)name, (void)values, fake_error(HD_INVALID_INPUT_TYPE, hdGetCurrentDevice()); }
void hdSetLongv(HDenum name, const int64_t *values) { (void)name, (void)values, fake_error(HD_INVALID_INPUT_TYPE, hdGetCurrentDevice()); }

HDenum hdCheckCalibration(void)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    HDenum state = device ? device->calibration : HD_CALIBRATION_NEEDS_MANUAL_INPUT;
    pthread_mutex_unlock(&fake_lock);
    return state;
}

HDenum hdCheckCalibrationStyle(void)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    HDenum styles = device ? (HDenum)device->styles : 0;
    pthread_mutex_unlock(&fake_lock);
    return styles;
}

void hdUpdateCalibration(HDenum style)
{
    pthread_mutex_lock(&fake_lock);
    struct fake_device *device = current_device();
    if (device && !(device->styles & (int)style))
        fake_error(HD_INVALID_VALUE, *current());
    else if (device && device->calibration == HD_CALIBRATION_NEEDS_UPDATE) {
        device->calibration = HD_CALIBRATION_OK;
        fake_log("calibrate %s %u", device->name, style);
    }
    pthread_mutex_unlock(&fake_lock);
}
