/* Ray-cast vehicles: the suspension of each wheel is a ray. Axes of the chassis: x forward, y right, z up. */
#ifndef AMB_VEHICLE_H
#define AMB_VEHICLE_H
#include "types.h"

/* A wheel, vectors in the inertial frame of the chassis. */
typedef struct AmbWheel {
  double connection[3]; /* m */
  double direction[3];  /* of the suspension; its length scales the length of the ray */
  double axle[3];
  double rest_length;         /* m */
  double radius;              /* m */
  double stiffness;           /* 1/s^2 */
  double damping_relaxation;  /* 1/s */
  double damping_compression; /* 1/s */
  double friction_slip;
  double roll_influence;
  int is_front;
} AmbWheel;

/* Adds a vehicle to a world. The chassis is dynamic and must outlive the vehicle. */
AmbVehicle *amb_vehicle_new(AmbWorld *world, AmbBody *chassis, const AmbWheel *wheels, int n);
/* Removes the vehicle from its world and frees it. */
void amb_vehicle_free(AmbVehicle *vehicle);
/* steering in rad, engine force in N, brake as the largest impulse of a sub-step in N s. */
void amb_vehicle_drive(AmbVehicle *vehicle, int wheel, double steering, double engine, double brake);
/* World pose of the drawn wheel on the chassis' motion state. */
void amb_vehicle_wheel_pose(AmbVehicle *vehicle, int wheel, double pose[12]);
/* Whether the wheel's ray hit a rigid body in the last sub-step. */
int amb_vehicle_on_ground(const AmbVehicle *vehicle, int wheel);
/* Sets suspensions to their rest length and wheel angles, steering, engine forces and brakes to zero. */
void amb_vehicle_reset(AmbVehicle *vehicle);

#endif
