/* A stand-in for Force Dimension's libdhd: as much of the SDK as nodes/driver/forcedimension uses.

   As the vendor's: a call that fails gives -1 and leaves its out-parameters alone; positive numbers are remarks; forces need to be
   enabled; the firmware's watchdog cuts a force that nobody renews. Axes of an upright device: to the operator, right, up. */

#include "world.h"

#define OK 0
#define FAILED (-1)

static int last_error;
static int expert;
static int opened = -1;

static world *here(void) { return world_of((void *) here); }

static int fails(const char *call) {
    if (!world_fails(here(), call)) return 0;
    last_error = here()->unplugged ? 5 : 7;
    return 1;
}

/* A device that is not the one that was opened is none. */
static int wrong(const char *call, char id) {
    if (fails(call)) return 1;
    if (opened >= 0 && (id == opened || id == -1)) return 0;
    last_error = 5;
    return 1;
}

static int remark(void) { return here()->positive ? 1 : OK; }

int dhdErrorGetLast(void) { return last_error; }
const char *dhdErrorGetLastStr(void) { return last_error ? "stand-in error" : "no error"; }
const char *dhdGetSDKVersionStr(void) { return "stand-in 3.17.5"; }
int dhdGetDeviceCount(void) { return here()->unplugged ? 0 : here()->devices; }
int dhdGetAvailableCount(void) { return dhdGetDeviceCount(); }

/* Devices 0, 1, ... have serial numbers one after the other; the arm is that of the last. */
int dhdOpenID(char id) {
    if (fails("dhdOpenID")) return FAILED;
    if (id < 0 || id >= here()->devices) {
        last_error = 5;
        return FAILED;
    }
    if (opened >= 0) here()->broken++;
    opened = id;
    here()->open++;
    here()->forces = 0;
    return opened;
}

int dhdClose(char id) {
    if (opened < 0) here()->broken++;
    here()->open--;
    here()->forces = 0;
    opened = -1;
    return fails("dhdClose") || (id != -1 && 0) ? FAILED : OK;
}

int dhdStop(char id) {
    static const double zero[3];
    (void) id;
    here()->forces = 0;
    world_push(here(), zero);
    return fails("dhdStop") ? FAILED : OK;
}

int dhdGetSerialNumber(unsigned short *serial, char id) {
    if (wrong("dhdGetSerialNumber", id)) return FAILED;
    *serial = (unsigned short) (here()->serial - (here()->devices - 1 - opened));
    return remark();
}

const char *dhdGetSystemName(char id) { return wrong("dhdGetSystemName", id) ? 0 : "stand-in of an omega.3"; }
int dhdGetSystemType(char id) { return wrong("dhdGetSystemType", id) ? FAILED : 33; }

int dhdGetVersionStr(char *text, size_t size, char id) {
    if (wrong("dhdGetVersionStr", id)) return FAILED;
    snprintf(text, size, "0.0");
    return remark();
}

int dhdGetStatus(int *status, char id) {
    if (wrong("dhdGetStatus", id)) return FAILED;
    memset(status, 0, 17 * sizeof(int));
    status[0] = status[1] = status[2] = 1;
    status[3] = here()->manual;
    status[5] = here()->forces && !here()->cause;
    status[14] = here()->forces ? here()->cause : 4;
    return remark();
}

int dhdEnableForce(unsigned char on, char id) {
    if (wrong("dhdEnableForce", id)) return FAILED;
    here()->forces = on;
    return remark();
}

int dhdSetGravityCompensation(int on, char id) {
    if (wrong("dhdSetGravityCompensation", id)) return FAILED;
    here()->carries = on;
    return remark();
}

int dhdSetEffectorMass(double mass, char id) {
    if (wrong("dhdSetEffectorMass", id)) return FAILED;
    if (!(mass >= 0.0)) here()->broken++;
    here()->tool_mass = mass;
    return remark();
}

int dhdSetBaseAngleXDeg(double angle, char id) {
    if (wrong("dhdSetBaseAngleXDeg", id)) return FAILED;
    here()->base[0] = angle;
    return remark();
}

int dhdSetBaseAngleZDeg(double angle, char id) {
    if (wrong("dhdSetBaseAngleZDeg", id)) return FAILED;
    here()->base[1] = angle;
    return remark();
}

double dhdGetMaxForce(char id) { return wrong("dhdGetMaxForce", id) ? -1.0 : here()->peak; }

int dhdSetMaxForce(double force, char id) {
    if (!(force > 0.0)) here()->broken++;
    return wrong("dhdSetMaxForce", id) ? FAILED : remark();
}

int dhdEnableExpertMode(void) {
    if (fails("dhdEnableExpertMode")) return FAILED;
    expert = 1;
    return OK;
}

int dhdSetWatchdog(unsigned char units, char id) {
    if (wrong("dhdSetWatchdog", id)) return FAILED;
    if (!expert) {
        last_error = 9;
        return FAILED;
    }
    here()->watchdog = 125e-6 * units;
    return remark();
}

int dhdGetPosition(double *x, double *y, double *z, char id) {
    double position[3], velocity[3];
    if (wrong("dhdGetPosition", id) || !world_read(here(), position, velocity)) return FAILED;
    *x = -position[0];
    *y = -position[1];
    *z = position[2];
    return remark();
}

int dhdGetLinearVelocity(double *x, double *y, double *z, char id) {
    world *w = here();
    if (wrong("dhdGetLinearVelocity", id)) return FAILED;
    *x = -w->velocity[0];
    *y = -w->velocity[1];
    *z = w->velocity[2];
    return remark();
}

int dhdGetOrientationFrame(double matrix[3][3], char id) {
    if (wrong("dhdGetOrientationFrame", id)) return FAILED;
    memcpy(matrix, here()->turn, sizeof(here()->turn));
    return remark();
}

int dhdGetGripperGap(double *gap, char id) {
    if (wrong("dhdGetGripperGap", id)) return FAILED;
    *gap = here()->gripper;
    return remark();
}

_Bool dhdHasWrist(char id) { return !wrong("dhdHasWrist", id); }
_Bool dhdHasGripper(char id) { return !wrong("dhdHasGripper", id); }
unsigned int dhdGetButtonMask(char id) { return wrong("dhdGetButtonMask", id) ? 0 : (unsigned int) here()->buttons; }

int dhdSetForce(double x, double y, double z, char id) {
    const double force[3] = {-x, -y, z};
    if (wrong("dhdSetForce", id)) return FAILED;
    world_push(here(), force);
    return here()->positive ? 2 : OK;
}

int dhdGetJointAngles(double joints[8], char id) {
    if (wrong("dhdGetJointAngles", id)) return FAILED;
    /* As if the joints were the place itself. */
    for (int i = 0; i < 8; i++) joints[i] = i < 3 ? here()->position[i] : 0.0;
    return remark();
}

int dhdJointAnglesToInertiaMatrix(double joints[8], double inertia[6][6], char id) {
    if (wrong("dhdJointAnglesToInertiaMatrix", id)) return FAILED;
    memset(inertia, 0, 36 * sizeof(double));
    /* Half as heavy again towards the operator, as a delta is; and 100 % heavier for each 0.1 m to the left. */
    double here_mass = here()->mass * (1.0 + 10.0 * joints[1]);
    inertia[0][0] = 1.5 * here_mass;
    inertia[1][1] = inertia[2][2] = here_mass;
    return remark();
}
