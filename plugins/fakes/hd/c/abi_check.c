/* `abi_check LIBRARY` calls every function of the fake libHD.so through C and checks what comes back; exit status 0 if all is right.
   `abi_check LIBRARY NAME` prints model and position of the device of that name, as AMBF_FAKE_HD has set it up. */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hd_abi.h"

static void *library;
static int checks;

static void *get(const char *name)
{
    void *symbol = dlsym(library, name);
    if (!symbol) {
        fprintf(stderr, "%s is missing\n", name);
        exit(2);
    }
    return symbol;
}

#define CALL(function) ((__typeof__(&function))get(#function))
#define CHECK(condition)                                                        \
    do {                                                                        \
        checks++;                                                               \
        if (!(condition)) {                                                     \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition);             \
            exit(1);                                                            \
        }                                                                       \
    } while (0)

static int calls;

static uint32_t three_times(void *user)
{
    *(int *)user += 1;
    return ++calls < 3 ? HD_CALLBACK_CONTINUE : HD_CALLBACK_DONE;
}

static uint32_t forever(void *user)
{
    *(volatile int *)user += 1;
    return HD_CALLBACK_CONTINUE;
}

static int show(const char *name)
{
    double p[3];
    HHD device = CALL(hdInitDevice)(name);
    CHECK(device != HD_INVALID_HANDLE);
    CALL(hdBeginFrame)(device);
    CALL(hdGetDoublev)(HD_CURRENT_POSITION, p);
    CALL(hdEndFrame)(device);
    CHECK(CALL(hdGetError)().errorCode == HD_SUCCESS);
    printf("%s %g %g %g\n", CALL(hdGetString)(HD_DEVICE_MODEL_TYPE), p[0], p[1], p[2]);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc < 2 || !(library = dlopen(argv[1], RTLD_NOW))) {
        fprintf(stderr, "cannot open the library\n");
        return 2;
    }
    if (argc > 2)
        return show(argv[2]);
    char reply[256];
    CHECK(sizeof(HDErrorInfo) == 12);
    CHECK(CALL(ambf_fake_hd_control)("reset", NULL, 0) == 0);
    CHECK(CALL(ambf_fake_hd_control)("device One = Touch", NULL, 0) == 0);
    CHECK(CALL(ambf_fake_hd_control)("One: pose 1 2 3", NULL, 0) == 0);
    CHECK(CALL(ambf_fake_hd_control)("nonsense", NULL, 0) == -1);

    CHECK(CALL(hdInitDevice)("Nobody") == HD_INVALID_HANDLE);
    HDErrorInfo error = CALL(hdGetError)();
    CHECK(error.errorCode == HD_COMM_ERROR && error.internalErrorCode == -HD_COMM_ERROR && error.hHD == HD_INVALID_HANDLE);
    CHECK(strcmp(CALL(hdGetErrorString)(HD_COMM_ERROR), "device error") == 0);
    CHECK(CALL(hdGetError)().errorCode == HD_SUCCESS);

    HHD device = CALL(hdInitDevice)("One");
    CHECK(device != HD_INVALID_HANDLE && CALL(hdGetCurrentDevice)() == device);
    CHECK(CALL(hdInitDevice)("One") == HD_INVALID_HANDLE && CALL(hdGetError)().errorCode == HD_DEVICE_ALREADY_INITIATED);
    CALL(hdMakeCurrentDevice)(77);
    error = CALL(hdGetError)();
    CHECK(error.errorCode == HD_BAD_HANDLE && error.hHD == 77);
    CHECK(CALL(hdGetCurrentDevice)() == device);
    CHECK(strcmp(CALL(hdGetString)(HD_DEVICE_MODEL_TYPE), "Touch") == 0);
    CALL(hdEnable)(HD_FORCE_OUTPUT);
    CHECK(CALL(hdIsEnabled)(HD_FORCE_OUTPUT) == 1);
    CALL(hdDisable)(HD_FORCE_OUTPUT);
    CHECK(CALL(hdIsEnabled)(HD_FORCE_OUTPUT) == 0);
    CHECK(CALL(hdCheckCalibrationStyle)() == (HD_CALIBRATION_AUTO | HD_CALIBRATION_INKWELL));
    CHECK(CALL(ambf_fake_hd_control)("One: calibration update", NULL, 0) == 0);
    CHECK(CALL(hdCheckCalibration)() == HD_CALIBRATION_NEEDS_UPDATE);
    CALL(hdUpdateCalibration)(HD_CALIBRATION_AUTO);
    CHECK(CALL(hdCheckCalibration)() == HD_CALIBRATION_OK);

    double position[3] = { 0 };
    CALL(hdGetDoublev)(HD_CURRENT_POSITION, position);
    CHECK(CALL(hdGetError)().errorCode == HD_FRAME_ERROR); /* outside a frame */
    CALL(hdEndFrame)(device);
    CHECK(CALL(hdGetError)().errorCode == HD_ILLEGAL_END);
    CALL(hdBeginFrame)(device);
    CALL(hdBeginFrame)(device);
    CHECK(CALL(hdGetError)().errorCode == HD_ILLEGAL_BEGIN);
    CALL(hdGetDoublev)(HD_CURRENT_POSITION, position);
    CHECK(position[0] == 1.0 && position[1] == 2.0 && position[2] == 3.0);
    float floats[3];
    CALL(hdGetFloatv)(HD_CURRENT_POSITION, floats);
    CHECK(floats[2] == 3.0f);
    int32_t whole = -1;
    CALL(hdGetIntegerv)(HD_CURRENT_BUTTONS, &whole);
    CHECK(whole == 0);
    HDboolean truth = 9;
    CALL(hdGetBooleanv)(HD_CURRENT_SAFETY_SWITCH, &truth);
    CHECK(truth == 0);
    int64_t encoders[6];
    CALL(hdGetLongv)(HD_CURRENT_ENCODER_VALUES, encoders);
    CHECK(encoders[5] == 0);
    const double force[3] = { 0.0, 5.0, 0.0 };
    CALL(hdSetDoublev)(HD_CURRENT_FORCE, force);
    CALL(hdEndFrame)(device);
    CHECK(CALL(hdGetError)().errorCode == 0x0201); /* too large */
    const float torque[3] = { 1.0f, 0.0f, 0.0f };
    CALL(hdBeginFrame)(device);
    CALL(hdSetFloatv)(HD_CURRENT_TORQUE, torque);
    CALL(hdSetBooleanv)(HD_CURRENT_FORCE, &truth);
    CHECK(CALL(hdGetError)().errorCode == HD_INVALID_INPUT_TYPE);
    CALL(hdSetIntegerv)(HD_CURRENT_FORCE, &whole);
    CHECK(CALL(hdGetError)().errorCode == HD_INVALID_INPUT_TYPE);
    CALL(hdSetLongv)(HD_CURRENT_FORCE, encoders);
    CHECK(CALL(hdGetError)().errorCode == HD_INVALID_INPUT_TYPE);
    CALL(hdEndFrame)(device);
    CHECK(CALL(ambf_fake_hd_control)("One: frames", reply, sizeof reply) == 0 && strcmp(reply, "2") == 0);
    CHECK(CALL(hdGetError)().errorCode == HD_SUCCESS);

    CALL(hdSetSchedulerRate)(77);
    CHECK(CALL(hdGetError)().errorCode == HD_INVALID_VALUE);
    CALL(hdSetSchedulerRate)(1000);
    CALL(hdStartScheduler)();
    int count = 0;
    CALL(hdScheduleSynchronous)(three_times, &count, 500);
    CHECK(count == 3);
    calls = 0;
    HDSchedulerHandle handle = CALL(hdScheduleAsynchronous)(three_times, &count, 0xFFFF);
    CHECK(handle != 0 && CALL(hdWaitForCompletion)(handle, HD_WAIT_INFINITE) == 0 && count == 6);
    volatile int beats = 0;
    handle = CALL(hdScheduleAsynchronous)(forever, (void *)&beats, 0);
    CHECK(CALL(hdWaitForCompletion)(handle, HD_WAIT_CHECK_STATUS) == 1);
    CHECK(CALL(hdGetSchedulerTimeStamp)() >= 0.0);
    CALL(hdUnschedule)(handle);
    int after = beats;
    calls = 0;
    CALL(hdScheduleSynchronous)(three_times, &count, 1);
    CHECK(beats == after && count == 9);
    CALL(hdStopScheduler)();
    CALL(hdDisableDevice)(device);
    CALL(hdDisableDevice)(device);
    CHECK(CALL(hdGetError)().errorCode == HD_BAD_HANDLE);
    CHECK(CALL(hdGetError)().errorCode == HD_SUCCESS);
    printf("%d checks\n", checks);
    return 0;
}
