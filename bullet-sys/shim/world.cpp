#include <btBulletDynamicsCommon.h>
extern "C" {
#include "shim.h"
int amb_scalar_size(void) { return (int)sizeof(btScalar); }
}
