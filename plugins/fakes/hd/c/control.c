/* What drives the fake HD library: commands of the variable AMBF_FAKE_HD, separated by `;`, and of the function
   `ambf_fake_hd_control`, one at a time. It gives back 0, or -1 for a command that it does not know. Commands:

     device NAME = MODEL          there is a device of that name
     reset                        there is none
     NAME: pose X Y Z             the tip is there, mm
     NAME: turn X Y Z A           orientation: A degrees about that axis
     NAME: circle R F             the tip goes around, R mm, F Hz
     NAME: hand M K D             a mass [kg] that spring [N/m] and damper [N·s/m] pull to the script, and forces push; M = 0: none
     NAME: buttons MASK           pressed buttons
     NAME: joints A B C           rad; `gimbal` likewise
     NAME: calibration ok|update|manual
     NAME: styles MASK            1 encoder reset, 2 auto, 4 inkwell
     NAME: fail init|ok           it cannot be initialised
     NAME: fault on|off           every frame fails
     NAME: comm N                 so do the next N
     NAME: warm N                 warm motors in the next N frames
     NAME: steal N                another device becomes current in the next N frames
     NAME: frames                 replies how many frames it had
     NAME: force I                replies time, force and torque of frame I; the last if I < 0
     NAME: enabled                replies whether force output and clamping are on
     current process|thread       the current device is one for the process; one for each thread
     stall S                      the scheduler stands still for so long
     error CODE                   an error of the scheduler, hexadecimal, in the next tick
     log                          replies what was called so far

   Without the variable there is one `Touch`, `Default Device`, whose tip goes around a circle. */
#define _GNU_SOURCE
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fake.h"

static void turn(struct fake_device *device, const double *v)
{
    double norm = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), a = v[3] * M_PI / 180.0, c = cos(a), s = sin(a);
    double x = v[0] / norm, y = v[1] / norm, z = v[2] / norm, t = 1.0 - c;
    const double rotation[9] = { t * x * x + c, t * x * y + s * z, t * x * z - s * y,
        t * x * y - s * z, t * y * y + c, t * y * z + s * x,
        t * x * z + s * y, t * y * z - s * x, t * z * z + c };
    memcpy(device->rotation, rotation, sizeof rotation);
}

static int on_device(struct fake_device *device, const char *verb, const char *rest, char *reply, uint64_t size)
{
    double v[4] = { 0, 0, 0, 0 };
    int count = sscanf(rest, "%lf %lf %lf %lf", &v[0], &v[1], &v[2], &v[3]);
    char word[16] = "";
    sscanf(rest, "%15s", word);
    struct vec three = { { v[0], v[1], v[2] } };
    if (!strcmp(verb, "pose") && count == 3) {
        device->centre = three;
        device->radius = 0.0;
    } else if (!strcmp(verb, "turn") && count == 4) {
        turn(device, v);
    } else if (!strcmp(verb, "circle") && count == 2) {
        device->radius = v[0];
        device->frequency = v[1];
    } else if (!strcmp(verb, "hand") && count == 3) {
        device->mass = v[0];
        device->stiffness = v[1];
        device->damping = v[2];
    } else if (!strcmp(verb, "buttons") && count == 1) {
        device->buttons = (int)v[0];
    } else if (!strcmp(verb, "joints") && count == 3) {
        device->joints = three;
    } else if (!strcmp(verb, "gimbal") && count == 3) {
        device->gimbal = three;
    } else if (!strcmp(verb, "calibration") && *word) {
        device->calibration = !strcmp(word, "ok") ? HD_CALIBRATION_OK
            : !strcmp(word, "update")             ? HD_CALIBRATION_NEEDS_UPDATE
                                                  : HD_CALIBRATION_NEEDS_MANUAL_INPUT;
    } else if (!strcmp(verb, "styles") && count == 1) {
        device->styles = (int)v[0];
    } else if (!strcmp(verb, "fail")) {
        device->fail_init = !strcmp(word, "init");
    } else if (!strcmp(verb, "fault")) {
        device->fault = !strcmp(word, "on");
    } else if (!strcmp(verb, "comm") && count == 1) {
        device->comm_frames = (int)v[0];
    } else if (!strcmp(verb, "warm") && count == 1) {
        device->warm_frames = (int)v[0];
    } else if (!strcmp(verb, "steal") && count == 1) {
        device->stolen_frames = (int)v[0];
    } else if (!strcmp(verb, "frames")) {
        snprintf(reply, size, "%zu", device->force_count);
    } else if (!strcmp(verb, "force") && count == 1) {
        size_t all = device->force_count;
        size_t at = v[0] < 0.0 ? all - 1 : (size_t)v[0];
        if (at >= all || at + MAX_FORCES < all)
            return -1;
        const struct force_record *f = &device->forces[at % MAX_FORCES];
        snprintf(reply, size, "%.9f %.9f %.9f %.9f %.9f %.9f %.9f", f->time, f->force.x[0], f->force.x[1], f->force.x[2],
            f->torque.x[0], f->torque.x[1], f->torque.x[2]);
    } else if (!strcmp(verb, "enabled")) {
        snprintf(reply, size, "%d %d", device->output, device->clamping);
    } else {
        return -1;
    }
    return 0;
}

static int run(const char *command, char *reply, uint64_t size)
{
    char name[NAME], model[NAME], verb[16];
    double number;
    unsigned code;
    int at = 0;
    command += strspn(command, " \t\n");
    if (sscanf(command, "device %63[^=]= %63[^\n]", name, model) == 2) {
        for (size_t i = strlen(name); i > 0 && name[i - 1] == ' '; i--)
            name[i - 1] = 0;
        return fake_add(name, model) ? 0 : -1;
    }
    if (!strcmp(command, "reset")) {
        for (int i = 0; i < fake_device_count; i++)
            free(fake_devices[i].forces);
        fake_device_count = 0;
        return 0;
    }
    if (!strncmp(command, "current ", 8)) {
        fake_current_is_shared = !strcmp(command + 8, "process");
        return 0;
    }
    if (sscanf(command, "stall %lf", &number) == 1) {
        fake_stall(number);
        return 0;
    }
    if (sscanf(command, "error %x", &code) == 1) {
        fake_scheduler_error(code);
        return 0;
    }
    if (!strcmp(command, "log")) {
        fake_read_log(reply, size);
        return 0;
    }
    if (sscanf(command, "%63[^:]: %15s%n", name, verb, &at) == 2) {
        struct fake_device *device = fake_find(name);
        return device ? on_device(device, verb, command + at, reply, size) : -1;
    }
    return -1;
}

int ambf_fake_hd_control(const char *command, char *reply, uint64_t size)
{
    char none[1];
    pthread_mutex_lock(&fake_lock);
    int code = run(command, size ? reply : none, size ? size : 1);
    pthread_mutex_unlock(&fake_lock);
    return code;
}

__attribute__((constructor)) static void load(void)
{
    fake_time();
    const char *variable = getenv("AMBF_FAKE_HD");
    char *script = strdup(variable ? variable : "device Default Device = Touch; Default Device: circle 40 0.25");
    char *rest = script;
    for (char *command; (command = strsep(&rest, ";"));)
        if (command[strspn(command, " \t\n")] && ambf_fake_hd_control(command, NULL, 0) != 0)
            fprintf(stderr, "fake libHD: `%s` in AMBF_FAKE_HD is not known\n", command);
    free(script);
}
