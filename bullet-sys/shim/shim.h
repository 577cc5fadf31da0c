#ifndef AMBF_SHIM_H
#define AMBF_SHIM_H
int amb_scalar_size(void);
#endif
