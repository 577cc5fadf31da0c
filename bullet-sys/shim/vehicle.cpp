#include "internal.h"

struct AmbVehicle {
  BT_DECLARE_ALIGNED_ALLOCATOR();

  AmbVehicle(AmbWorld *owner, AmbBody *body)
      : world(owner),
        chassis(body),
        raycaster(owner->world.get()),
        vehicle(btRaycastVehicle::btVehicleTuning(), &body->body, &raycaster) {
    vehicle.setCoordinateSystem(1, 2, 0);
    // The suspension exerts forces in every sub-step, and the body below the wheels may be removed: the chassis never
    // sleeps.
    ++chassis->sleep_inhibitors;
    set_activation_state(*world, *chassis);
  }

  ~AmbVehicle() {
    --chassis->sleep_inhibitors;
    set_activation_state(*world, *chassis);
  }

  AmbWorld *world;
  AmbBody *chassis;
  btDefaultVehicleRaycaster raycaster;
  btRaycastVehicle vehicle;
};

extern "C" {

AmbVehicle *amb_vehicle_new(AmbWorld *world, AmbBody *chassis, const AmbWheel *wheels, int n) {
  auto *owner = new AmbVehicle(world, chassis);
  for (int i = 0; i < n; ++i) {
    const AmbWheel &wheel = wheels[i];
    btWheelInfo &info = owner->vehicle.addWheel(vector_of(wheel.connection), vector_of(wheel.direction),
                                                vector_of(wheel.axle), wheel.rest_length, wheel.radius,
                                                btRaycastVehicle::btVehicleTuning(), wheel.is_front != 0);
    info.m_suspensionStiffness = wheel.stiffness;
    info.m_wheelsDampingRelaxation = wheel.damping_relaxation;
    info.m_wheelsDampingCompression = wheel.damping_compression;
    info.m_frictionSlip = wheel.friction_slip;
    info.m_rollInfluence = wheel.roll_influence;
  }
  amb_vehicle_reset(owner);
  prepare_soft_rays(*world);
  world->world->addAction(&owner->vehicle);
  return owner;
}

void amb_vehicle_free(AmbVehicle *vehicle) {
  vehicle->world->world->removeAction(&vehicle->vehicle);
  delete vehicle;
}

void amb_vehicle_drive(AmbVehicle *vehicle, int wheel, double steering, double engine, double brake) {
  vehicle->vehicle.setSteeringValue(steering, wheel);
  vehicle->vehicle.applyEngineForce(engine, wheel);
  vehicle->vehicle.setBrake(brake, wheel);
}

void amb_vehicle_wheel_pose(AmbVehicle *vehicle, int wheel, double pose[12]) {
  vehicle->vehicle.updateWheelTransform(wheel, true);
  write_pose(vehicle->vehicle.getWheelTransformWS(wheel), pose);
}

// Not m_isInContact: reading a wheel's pose clears it.
int amb_vehicle_on_ground(const AmbVehicle *vehicle, int wheel) {
  return vehicle->vehicle.getWheelInfo(wheel).m_raycastInfo.m_groundObject != nullptr;
}

void amb_vehicle_reset(AmbVehicle *vehicle) {
  for (int i = 0; i < vehicle->vehicle.getNumWheels(); ++i) {
    amb_vehicle_drive(vehicle, i, 0, 0, 0);
    btWheelInfo &wheel = vehicle->vehicle.getWheelInfo(i);
    wheel.m_rotation = 0;
    wheel.m_deltaRotation = 0;
    // Bullet initialises these in the first sub-step only.
    wheel.m_raycastInfo.m_groundObject = nullptr;
    wheel.m_wheelsSuspensionForce = 0;
    wheel.m_skidInfo = 1;
  }
  vehicle->vehicle.resetSuspension();
  for (int i = 0; i < vehicle->vehicle.getNumWheels(); ++i) vehicle->vehicle.updateWheelTransform(i, false);
}

}  // extern "C"
