/* The C interface of plugins and drivers, version 2: the twin of ambf-plugin/src/abi.rs, and described in docs/plugins.md.
 *
 * Texts are UTF-8 without a terminating zero. Units: m, rad, s, kg, N; vectors are in world axes unless something else is said.
 * No exception may leave a function of a plugin. */
#ifndef AMBF_PLUGIN_H
#define AMBF_PLUGIN_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Hosts of this version load libraries of version 1, too: version 2 has only `show` in addition. */
#define AMBF_PLUGIN_ABI_VERSION 2u

/* What a callback returns. */
enum { AMBF_DONE = 0, AMBF_FAILED = 1, AMBF_PANICKED = 2 };

/* Kinds of plugins. */
enum { AMBF_SIMULATOR = 0, AMBF_WORLD = 1, AMBF_MODEL_PLUGIN = 2, AMBF_OBJECT = 3 };

/* Types of objects. AMBF_MODEL stands for models where objects are named by type and index. */
enum {
    AMBF_BODY = 0, AMBF_SOFT_BODY = 1, AMBF_GHOST = 2, AMBF_JOINT = 3, AMBF_SENSOR = 4, AMBF_ACTUATOR = 5,
    AMBF_VEHICLE = 6, AMBF_CAMERA = 7, AMBF_LIGHT = 8, AMBF_VOLUME = 9, AMBF_MODEL = 100
};

/* Negative results of the host's functions. */
enum {
    AMBF_NO_OBJECT = -1,  /* no such object, or no longer */
    AMBF_NOT_FINITE = -2, /* a number is NaN or infinite, or a quaternion has no length */
    AMBF_REFUSED = -3,    /* the object cannot do that, or a pointer is null */
    AMBF_OUTSIDE = -4,    /* not in a callback of the physics thread */
    AMBF_FULL = -5,       /* too many commands wait */
    AMBF_UNKNOWN = -6,    /* no such code */
    AMBF_TOO_MUCH = -7    /* more is to be shown than windows take */
};

typedef struct { const char *data; uint64_t length; } ambf_text;
typedef struct { double sim_time, dt; uint64_t step; } ambf_clock;
typedef struct { double position[3], orientation[4]; /* x y z w */ } ambf_pose;

typedef struct {
    ambf_pose pose;          /* body frame in the world, as reported */
    ambf_pose inertial_pose; /* inertial frame in the world */
    double linear_velocity[3], angular_velocity[3];
    double mass;             /* 0: static */
    double inertia[3];       /* principal moments */
} ambf_body;

typedef struct {
    double position, velocity, effort, lower, upper; /* limits are infinite where there are none */
    uint64_t parent, child;                          /* bodies */
} ambf_joint;

typedef struct {
    int64_t body; /* -1: no rigid body */
    double point[3], normal[3];
    double distance; /* ray: share of its way; contact: m, negative where bodies overlap */
    double impulse;  /* contact: N s in the last sub-step */
} ambf_touch;

/* Commands: what `index`, `kind`, `other` and `numbers` are. */
enum {
    AMBF_WRENCH = 1,       /* body; force x y z, torque x y z; for the next step */
    AMBF_VELOCITY = 2,     /* body; linear x y z, angular x y z */
    AMBF_POSE = 3,         /* body; position x y z, quaternion x y z w */
    AMBF_FOLLOW_POSE = 4,  /* as above, through the body's controller; for the next step */
    AMBF_JOINT_COMMAND = 5,/* joint; kind 0 effort, 1 position, 2 velocity; value; for the next step */
    AMBF_PLACE = 6,        /* kind: camera, light, ghost or volume; index; pose in the parent */
    AMBF_HOLD = 7,         /* actuator; other: body, -1 releases it */
    AMBF_DRIVE = 8,        /* vehicle; other: wheel; steering, power, brake; until the next */
    AMBF_SOFT_FORCE = 9,   /* soft body; force x y z; for the next step */
    AMBF_PULL_NODE = 10,   /* soft body; other: node; kind 1: goal x y z, kind 0: release */
    AMBF_ATTACH = 11,      /* body; other: body; the result is a number */
    AMBF_DETACH = 12,      /* index: that number */
    AMBF_RESET_WORLD = 13,
    AMBF_RESET_BODIES = 14,
    AMBF_PAUSE = 15,       /* kind 1 pause, 0 resume */
    AMBF_STEP = 16         /* kind: steps while paused */
};
typedef struct { uint32_t code, kind; uint64_t index; int64_t other; double numbers[8]; } ambf_command;

/* Markers, texts and pictures in windows. `numbers`: sphere: radius; box: edges; arrow along +x: length, radius; frame: length; points: size in pixels;
 * texts: x, y, height of a line in pixels; pictures: x, y, height in pixels, 0: the picture fills the window. Negative pixels count from the right and lower edge; shares are 0 to 1. A text or picture in the
 * scene is where the origin of its pose is seen. */
enum {
    AMBF_SHOW_SPHERE = 0, AMBF_SHOW_BOX = 1, AMBF_SHOW_ARROW = 2, AMBF_SHOW_FRAME = 3, AMBF_SHOW_POINTS = 4,
    AMBF_SHOW_LINES = 5, AMBF_SHOW_TEXT_PIXELS = 6, AMBF_SHOW_TEXT_SHARE = 7, AMBF_SHOW_TEXT_SCENE = 8,
    AMBF_SHOW_PICTURE_PIXELS = 9, AMBF_SHOW_PICTURE_SHARE = 10, AMBF_SHOW_PICTURE_SCENE = 11
};
typedef struct {
    uint32_t shape;
    uint32_t window;   /* from 1; 0: all windows */
    ambf_pose pose;    /* in the world; all zeros: the world's frame */
    double numbers[3];
    float color[4];    /* red, green, blue, alpha, 0 to 1 */
    float panel[4];    /* behind a text; alpha 0: nothing */
    const double (*points)[3]; /* of points and lines */
    uint64_t point_count;
    ambf_text text;    /* of texts */
    const uint8_t (*pixels)[4]; /* of pictures: red, green, blue, alpha, top row first */
    uint32_t width, height;     /* pixels of a picture, 1 to 8192 each */
    uint32_t behind;            /* of pictures: 1 behind the scene, 0 before it */
} ambf_drawing;

/* Input of a window, numbered from 1: code 0 key (key, scancode, action, mods), 1 button (button, 0, action, mods), 2 position (x, y), 3 scroll (x, y). */
typedef struct { uint32_t code, window; int32_t values[4]; double x, y; } ambf_input;

typedef struct {
    ambf_text handle;    /* name given to the plugin */
    ambf_text node;      /* YAML where it is declared */
    ambf_text directory; /* of the declaring file */
    const ambf_text *arguments;
    uint64_t argument_count; /* command line, the program's name first */
    uint32_t kind;           /* of the plugin */
    uint32_t object_kind;    /* type of the object, AMBF_MODEL for a model */
    uint64_t index;          /* of the model or object */
} ambf_init;

/* What the host offers. `context` is given to each function. Those below "now" work only in a callback that physics makes (init,
 * physics_update, reset, model_changed, object_changed), in its thread; those above in any thread as long as the plugin lives. */
typedef struct {
    const void *context;
    void (*say)(const void *context, ambf_text line);
    void (*fail)(const void *context, ambf_text why); /* before AMBF_FAILED is returned */
    int64_t (*post)(const void *context, const ambf_command *command);
    int32_t (*snapshot)(const void *context, ambf_clock *clock, ambf_body *bodies, uint64_t body_capacity,
                        ambf_joint *joints, uint64_t joint_capacity, uint64_t counts[2]); /* 0: none yet */
    /* now */
    int32_t (*clock)(const void *context, ambf_clock *out);
    int64_t (*count)(const void *context, uint32_t kind);
    int64_t (*find)(const void *context, uint32_t kind, ambf_text text);
    int64_t (*text)(const void *context, uint32_t what, uint32_t kind, uint64_t index, char *out,
                    uint64_t capacity); /* what: 0 name, 1 identifier, 2 file of a model; the result is the whole length */
    int64_t (*model_of)(const void *context, uint32_t kind, uint64_t index);
    int32_t (*body)(const void *context, uint64_t index, ambf_body *out);
    int32_t (*joint)(const void *context, uint64_t index, ambf_joint *out);
    int32_t (*pose)(const void *context, uint32_t kind, uint64_t index, ambf_pose *out);
    int64_t (*values)(const void *context, uint32_t kind, uint64_t index, double *out,
                      uint64_t capacity); /* sensor: measurements; ghost: bodies; soft body: nodes; actuator: holds */
    int32_t (*cast_ray)(const void *context, const double from[3], const double to[3], ambf_touch *out); /* 1: hit */
    int64_t (*contacts)(const void *context, uint64_t body, ambf_touch *out, uint64_t capacity);
    int64_t (*execute)(const void *context, const ambf_command *command);
    /* Any thread, since version 2: shows these in windows instead of what the plugin has shown before. */
    int64_t (*show)(const void *context, const ambf_drawing *drawings, uint64_t count);
} ambf_host;

/* A plugin. Functions may be null. Called from any thread, from one at a time. */
typedef struct ambf_plugin {
    void *instance;
    int32_t (*init)(void *instance, const ambf_init *init);
    int32_t (*physics_update)(void *instance, double dt);
    int32_t (*graphics_update)(void *instance);
    int32_t (*reset)(void *instance);
    int32_t (*model_changed)(void *instance, uint32_t added, uint64_t model);
    int32_t (*object_changed)(void *instance, uint32_t added, uint32_t kind, uint64_t index);
    int32_t (*input)(void *instance, const ambf_input *input);
    int32_t (*close)(void *instance);
    void (*destroy)(struct ambf_plugin *plugin);
} ambf_plugin;

/* What a library of plugins exports. `host` lives as long as the plugin. Null: no plugin of that kind. */
uint32_t ambf_plugin_abi_version(void);
ambf_plugin *ambf_plugin_create(uint32_t kind, const ambf_host *host);

/* ---- Drivers of input devices ---- */

/* Where a function of a driver says what it has to say, until it returns. */
typedef struct {
    const void *context;
    void (*fail)(const void *context, uint32_t kind, ambf_text why); /* kind 0: what is needed is not there; 1: the device is lost */
    void (*found)(const void *context, ambf_text model, ambf_text identity); /* in find: there is this device */
} ambf_answer;

/* Sentences for the user, from any thread, as long as the device is open. */
typedef struct {
    const void *context;
    void (*say)(const void *context, ambf_text sentence);
} ambf_log;

typedef struct { ambf_text key, value, place; } ambf_setting;
typedef struct { const ambf_setting *entries; uint64_t count; ambf_text directory; } ambf_settings;

typedef struct {
    ambf_text model, manufacturer;
    double max_force[3];     /* N, N m, gripper N */
    double max_stiffness[3]; /* N/m, N m/rad, gripper N/m */
    double max_damping[3];   /* N s/m, N m s/rad, gripper N s/m */
    double workspace_radius, gripper_max_angle, start_up_hold;
    uint32_t sensed, actuated; /* bits: 1 position, 2 rotation, 4 gripper */
    uint32_t hands;            /* bits: 1 left, 2 right */
} ambf_spec;

/* In the frame of the device: x out of it towards the user, y to the user's right, z up. */
typedef struct {
    double age; /* s since it was measured */
    uint64_t sequence;
    double position[3], rotation[4], linear_velocity[3], angular_velocity[3], gripper;
    uint32_t buttons;
    uint32_t flags; /* bits: 1 the pose may be trusted, 2 linear velocity, 4 angular velocity, 8 gripper */
} ambf_sample;
typedef struct { double force[3], torque[3], gripper; } ambf_force;

/* An open device: called from one thread at a time, about a thousand times a second. No function may be null. */
typedef struct ambf_device {
    void *instance;
    ambf_spec spec;
    int32_t (*read)(void *instance, const ambf_answer *answer, ambf_sample *out);
    int32_t (*write)(void *instance, const ambf_answer *answer, const ambf_force *force);
    int32_t (*close)(void *instance, const ambf_answer *answer);
    void (*destroy)(struct ambf_device *device);
} ambf_device;

/* A driver: called from any thread, also from several at a time; never freed. No function may be null. */
typedef struct {
    void *instance;
    ambf_text name;
    int32_t (*serves)(void *instance, ambf_text model);
    int32_t (*find)(void *instance, const ambf_answer *answer, ambf_text model, const ambf_settings *settings);
    ambf_device *(*open)(void *instance, const ambf_answer *answer, ambf_text model, ambf_text identity,
                         const ambf_settings *settings, const ambf_log *log);
} ambf_driver;

/* What a library of a driver exports, with ambf_plugin_abi_version. */
ambf_driver *ambf_driver_create(void);

#ifdef __cplusplus
}
#endif
#endif
