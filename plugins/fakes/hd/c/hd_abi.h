/* The HD interface of OpenHaptics as the fake library exports it: types, numbers and functions, 64-bit Linux.
   Written from the published numbers; no file of the vendor is needed or included. */
#ifndef HD_ABI_H
#define HD_ABI_H

#include <stdint.h>

typedef uint32_t HHD;
typedef uint32_t HDenum;
typedef uint8_t HDboolean;
typedef uint16_t HDushort;
typedef uint64_t HDulong;
typedef uint64_t HDSchedulerHandle;
typedef uint32_t (*HDSchedulerCallback)(void *user);

typedef struct {
    uint32_t errorCode;
    int32_t internalErrorCode;
    HHD hHD;
} HDErrorInfo;

enum {
    HD_CURRENT_BUTTONS = 0x2000,
    HD_CURRENT_SAFETY_SWITCH = 0x2001,
    HD_CURRENT_INKWELL_SWITCH = 0x2002,
    HD_CURRENT_ENCODER_VALUES = 0x2010,
    HD_CURRENT_POSITION = 0x2050,
    HD_CURRENT_VELOCITY = 0x2051,
    HD_CURRENT_TRANSFORM = 0x2052,
    HD_CURRENT_ANGULAR_VELOCITY = 0x2053,
    HD_CURRENT_JOINT_ANGLES = 0x2100,
    HD_CURRENT_GIMBAL_ANGLES = 0x2150,
    HD_LAST_OFFSET = 0x0200, /* added to CURRENT: the frame before */
    HD_VERSION = 0x2500,
    HD_DEVICE_MODEL_TYPE = 0x2501,
    HD_DEVICE_DRIVER_VERSION = 0x2502,
    HD_DEVICE_VENDOR = 0x2503,
    HD_DEVICE_SERIAL_NUMBER = 0x2504,
    HD_DEVICE_FIRMWARE_VERSION = 0x2505,
    HD_MAX_WORKSPACE_DIMENSIONS = 0x2550,
    HD_USABLE_WORKSPACE_DIMENSIONS = 0x2551,
    HD_TABLETOP_OFFSET = 0x2552,
    HD_INPUT_DOF = 0x2553,
    HD_OUTPUT_DOF = 0x2554,
    HD_CALIBRATION_STYLE = 0x2555,
    HD_UPDATE_RATE = 0x2600,
    HD_INSTANTANEOUS_UPDATE_RATE = 0x2601,
    HD_NOMINAL_MAX_STIFFNESS = 0x2602,
    HD_NOMINAL_MAX_FORCE = 0x2603,
    HD_NOMINAL_MAX_CONTINUOUS_FORCE = 0x2604,
    HD_CURRENT_FORCE = 0x2700,
    HD_CURRENT_TORQUE = 0x2701,
    HD_CURRENT_JOINT_TORQUE = 0x2703,
    HD_CURRENT_GIMBAL_TORQUE = 0x2704,
    HD_FORCE_OUTPUT = 0x4000,
    HD_MAX_FORCE_CLAMPING = 0x4001,
    HD_ONE_FRAME_LIMIT = 0x4004,
    HD_CALIBRATION_OK = 0x5000,
    HD_CALIBRATION_NEEDS_UPDATE = 0x5001,
    HD_CALIBRATION_NEEDS_MANUAL_INPUT = 0x5002,
    HD_CALIBRATION_ENCODER_RESET = 1,
    HD_CALIBRATION_AUTO = 2,
    HD_CALIBRATION_INKWELL = 4,
    HD_SUCCESS = 0,
    HD_INVALID_ENUM = 0x0100,
    HD_INVALID_VALUE = 0x0101,
    HD_INVALID_OPERATION = 0x0102,
    HD_INVALID_INPUT_TYPE = 0x0103,
    HD_BAD_HANDLE = 0x0104,
    HD_WARM_MOTORS = 0x0200,
    HD_EXCEEDED_MAX_FORCE = 0x0201,
    HD_DEVICE_FAULT = 0x0300,
    HD_DEVICE_ALREADY_INITIATED = 0x0301,
    HD_COMM_ERROR = 0x0302,
    HD_TIMER_ERROR = 0x0304,
    HD_ILLEGAL_BEGIN = 0x0400,
    HD_ILLEGAL_END = 0x0401,
    HD_FRAME_ERROR = 0x0402,
    HD_SCHEDULER_FULL = 0x0501,
    HD_WAIT_CHECK_STATUS = 0,
    HD_WAIT_INFINITE = 1,
    HD_CALLBACK_DONE = 0,
    HD_CALLBACK_CONTINUE = 1
};
#define HD_INVALID_HANDLE 0xFFFFFFFFu

#define EXPORT __attribute__((visibility("default")))

EXPORT HHD hdInitDevice(const char *name);
EXPORT void hdDisableDevice(HHD device);
EXPORT void hdMakeCurrentDevice(HHD device);
EXPORT HHD hdGetCurrentDevice(void);
EXPORT void hdBeginFrame(HHD device);
EXPORT void hdEndFrame(HHD device);
EXPORT HDErrorInfo hdGetError(void);
EXPORT const char *hdGetErrorString(uint32_t code);
EXPORT void hdEnable(HDenum capability);
EXPORT void hdDisable(HDenum capability);
EXPORT HDboolean hdIsEnabled(HDenum capability);
EXPORT void hdGetBooleanv(HDenum name, HDboolean *values);
EXPORT void hdGetIntegerv(HDenum name, int32_t *values);
EXPORT void hdGetFloatv(HDenum name, float *values);
EXPORT void hdGetDoublev(HDenum name, double *values);
EXPORT void hdGetLongv(HDenum name, int64_t *values);
EXPORT const char *hdGetString(HDenum name);
EXPORT void hdSetBooleanv(HDenum name, const HDboolean *values);
EXPORT void hdSetIntegerv(HDenum name, const int32_t *values);
EXPORT void hdSetFloatv(HDenum name, const float *values);
EXPORT void hdSetDoublev(HDenum name, const double *values);
EXPORT void hdSetLongv(HDenum name, const int64_t *values);
EXPORT HDenum hdCheckCalibration(void);
EXPORT HDenum hdCheckCalibrationStyle(void);
EXPORT void hdUpdateCalibration(HDenum style);
EXPORT void hdStartScheduler(void);
EXPORT void hdStopScheduler(void);
EXPORT void hdSetSchedulerRate(HDulong rate);
EXPORT void hdScheduleSynchronous(HDSchedulerCallback callback, void *user, HDushort priority);
EXPORT HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback callback, void *user, HDushort priority);
EXPORT void hdUnschedule(HDSchedulerHandle handle);
EXPORT HDboolean hdWaitForCompletion(HDSchedulerHandle handle, uint32_t code);
EXPORT double hdGetSchedulerTimeStamp(void);

/* Not part of HD: see control.c. */
EXPORT int ambf_fake_hd_control(const char *command, char *reply, uint64_t size);

#endif
