/* A double of Kinova's command layer: the vendor's functions, structures and calling convention, over a small arm.
 *
 * Built twice by the tests, as the USB library and, with -DETHERNET, as the Ethernet one (prefix Ethernet_). Layouts
 * and signatures are those of the published headers; the arm is written here a second time, in C, from the published
 * geometry, so that it shares no mistake with the Python double. Time stands still unless double_advance is called or
 * double_real_time(1) lets it run with the host's clock.
 */
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#ifdef ETHERNET
#define VENDOR(name) Ethernet_##name
#else
#define VENDOR(name) name
#endif

/* Structures of the vendor's headers ------------------------------------------------------------------------------ */

typedef struct { float X, Y, Z, ThetaX, ThetaY, ThetaZ; } CartesianInfo;
typedef struct { float Actuator[7]; } AngularInfo;
typedef struct { float Finger[3]; } FingersPosition;
typedef struct { CartesianInfo Coordinates; FingersPosition Fingers; } CartesianPosition;
typedef struct { AngularInfo Actuators; FingersPosition Fingers; } AngularPosition;
typedef struct {
    int Type;
    float Delay;
    CartesianInfo CartesianPosition;
    AngularInfo Actuators;
    int HandMode;
    FingersPosition Fingers;
} UserPosition;
typedef struct { float speed[3], force[3], acceleration[3]; } Limitation;
typedef struct { UserPosition Position; int LimitationsActive, SynchroType; Limitation Limitations; } TrajectoryPoint;
typedef struct { unsigned int TrajectoryCount; float UsedPercentage; unsigned int MaxSize; } TrajectoryFIFO;
typedef struct { short ButtonValue[16]; float axes[6]; } JoystickCommand;
typedef struct {
    char SerialNumber[20], Model[20];
    int VersionMajor, VersionMinor, VersionRelease, DeviceType, DeviceID;
} KinovaDevice;
typedef struct { float Voltage, Current, Acceleration[3], ActuatorTemp[7], FingerTemp[3]; } SensorsInfo;
typedef struct {
    unsigned char FingerStatus[3], RetractType, RetractComplexity, ControlEnableStatus, ControlActiveModule,
        ControlFrameType, CartesianFaultState, ForceControlStatus, CurrentLimitationStatus, RobotType, RobotEdition,
        TorqueSensorsStatus;
} QuickStatus;
typedef struct { float Actuator[7]; CartesianInfo Cartesian; } ForcesInfo;
typedef struct {
    unsigned long localIpAddress, subnetMask, robotIpAddress;
    unsigned short localCmdport, localBcastPort, robotPort;
    unsigned long rxTimeOutInMs;
} EthernetCommConfig;
typedef struct { unsigned int flags[11]; } SystemStatus;
typedef struct {
    double TimeAbsolute, TimeFromStartup;
    unsigned int IndexStartup;
    int ExpansionLong1;
    float TimeStampSavings, ExpansionFloat, SupplyVoltage, TotalCurrent, Power, AveragePower, Acceleration[3],
        SensorExpansion[3];
    unsigned int CodeVersion, CodeRevision;
    unsigned short Status, Controller, ControlMode, HandMode, ConnectedActuatorCount, PositionType,
        ErrorsSpiExpansion[2], ErrorsMainSPICount, ErrorsExternalSPICount, ErrorsMainCANCount, ErrorsExternalCANCount;
    SystemStatus ActualSystemStatus;
    UserPosition Position, Command, Current, Force;
    Limitation ActualLimitations;
    float ControlIncrement[7], FingerControlIncrement[3];
    JoystickCommand ActualJoystickCommand;
    unsigned int PeripheralsConnected[4], PeripheralsDeviceID[4];
    float ActuatorsTemperatures[7], FingersTemperatures[3], FutureTemperatures[3];
    int ActuatorsCommErrors[7], FingersCommErrors[3], ExpansionLong2;
    double ControlTimeAbsolute, ControlTimeFromStartup;
    unsigned char ExpansionsBytes[192];
} GeneralInformations;

typedef struct { int shapeType, Expansion1; CartesianInfo Points[8]; } ZoneShape;
typedef struct { int ID, Expansion1; ZoneShape zoneShape; Limitation zoneLimitation; int Expansion2; } Zone;
typedef struct { int NbZones, Expansion1; Zone Zones[10]; } ZoneList;

enum { OK = 1, NO_DEVICE = 1015, INVALID = 2100, NOT_INITIALIZED = 2101, NACK = 9999 };
enum { FIFO_SIZE = 2000, INJECTED_MAX = 64 };
#define CYCLE 0.01
#define FINGER_CLOSED 6800.0
#define FINGER_SPEED 5000.0

/* Geometry: joint origins xyz [m] and rpy [parts of pi]; range [deg], 0 0 = without end; speed [deg/s] ------------ */

typedef struct { double xyz[3], rpy[3], low, high, speed; } Joint;

static const Joint SIX[6] = {
    {{0, 0, .15675}, {0, 1, 0}, 0, 0, 36},
    {{0, .0016, -.11875}, {-.5, 0, 1}, 47, 313, 36},
    {{0, -.410, 0}, {0, 1, 0}, 19, 341, 36},
    {{0, .2073, -.0114}, {-.5, 0, 1}, 0, 0, 48},
    {{0, -.03703, -.06414}, {1. / 3, 0, 1}, 0, 0, 48},
    {{0, -.03703, -.06414}, {1. / 3, 0, 1}, 0, 0, 48},
};
static const Joint SPHERICAL_SIX[6] = {
    {{0, 0, .15675}, {0, 1, 0}, 0, 0, 36},
    {{0, .0016, -.11875}, {-.5, 0, 1}, 47, 313, 36},
    {{0, -.410, 0}, {0, 1, 0}, 19, 341, 36},
    {{0, .2073, -.0114}, {-.5, 0, 1}, 0, 0, 48},
    {{0, 0, -.10375}, {.5, 0, 1}, 30, 330, 48},
    {{0, .10375, 0}, {-.5, 0, 1}, 0, 0, 48},
};
static const Joint SEVEN[7] = {
    {{0, 0, .15675}, {0, 1, 0}, 0, 0, 36},
    {{0, .0016, -.11875}, {-.5, 0, 1}, 47, 313, 36},
    {{0, -.205, 0}, {-.5, 0, 0}, 0, 0, 36},
    {{0, 0, -.205}, {.5, 0, 1}, 30, 330, 36},
    {{0, .2073, -.0114}, {-.5, 0, 1}, 0, 0, 48},
    {{0, 0, -.10375}, {.5, 0, 1}, 65, 295, 48},
    {{0, .10375, 0}, {-.5, 0, 1}, 0, 0, 48},
};
static const Joint HAND = {{0, 0, -.16}, {1, 0, .5}, 0, 0, 0};
static const double HOME_SIX[7] = {275, 167.4, 57.4, 240, 82.7, 75.5, 0};
static const double HOME_SPHERICAL_SIX[7] = {283, 162, 43, 265, 257, 288, 0};
static const double HOME_SEVEN[7] = {283, 162, 0, 43, 265, 257, 288};

static const struct { int type, joints; const char *name; const Joint *chain; const double *home; } MODELS[3] = {
    {3, 6, "j2n6s300", SIX, HOME_SIX},
    {7, 6, "j2s6s300", SPHERICAL_SIX, HOME_SPHERICAL_SIX},
    {8, 7, "j2s7s300", SEVEN, HOME_SEVEN},
};

/* The arm --------------------------------------------------------------------------------------------------------- */

static struct {
    int joints, type;
    const char *name;
    const Joint *chain;
    const double *home;
    double q[7], rates[7], fingers[3], wrench[6];
    double frames[8][16];
    TrajectoryPoint fifo[FIFO_SIZE];
    int first, count;
    int initialized, control, cold, homing, opening, fingers_ready;
    int homed, cartesian; /* it went home since it was switched on; it takes Cartesian velocities */
    KinovaDevice active;
    EthernetCommConfig ethernet;
} arm;

static struct { char name[48]; int code, times; } injected[INJECTED_MAX];
static int real_time;
static double lived_s; /* time that has been lived through, on whichever clock */
static double manual_s;

static void multiply(const double *a, const double *b, double *out) {
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            double sum = 0;
            for (int k = 0; k < 4; k++) sum += a[4 * i + k] * b[4 * k + j];
            out[4 * i + j] = sum;
        }
}

static void rotation_zyx(double roll, double pitch, double yaw, double *r /* 3 x 3 */) {
    double cr = cos(roll), sr = sin(roll), cp = cos(pitch), sp = sin(pitch), cy = cos(yaw), sy = sin(yaw);
    double out[9] = {cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
                     sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
                     -sp,     cp * sr,                cp * cr};
    memcpy(r, out, sizeof out);
}

static void joint_frame(const Joint *joint, double angle_deg, double *out) {
    double r[9], turn = angle_deg * M_PI / 180, c = cos(turn), s = sin(turn);
    rotation_zyx(joint->rpy[0] * M_PI, joint->rpy[1] * M_PI, joint->rpy[2] * M_PI, r);
    for (int i = 0; i < 3; i++) {
        out[4 * i] = r[3 * i] * c + r[3 * i + 1] * s;
        out[4 * i + 1] = -r[3 * i] * s + r[3 * i + 1] * c;
        out[4 * i + 2] = r[3 * i + 2];
        out[4 * i + 3] = joint->xyz[i];
    }
    out[12] = out[13] = out[14] = 0;
    out[15] = 1;
}

static void forward(void) {
    double base[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}, local[16];
    const double *parent = base;
    for (int i = 0; i < arm.joints; i++) {
        joint_frame(&arm.chain[i], arm.q[i], local);
        multiply(parent, local, arm.frames[i]);
        parent = arm.frames[i];
    }
    joint_frame(&HAND, 0, local);
    multiply(parent, local, arm.frames[arm.joints]);
}

static void jacobian(double *j /* 6 x joints */) {
    const double *hand = arm.frames[arm.joints];
    for (int i = 0; i < arm.joints; i++) {
        const double *f = arm.frames[i];
        double z[3] = {f[2], f[6], f[10]}, d[3] = {hand[3] - f[3], hand[7] - f[7], hand[11] - f[11]};
        double column[6] = {z[1] * d[2] - z[2] * d[1], z[2] * d[0] - z[0] * d[2], z[0] * d[1] - z[1] * d[0], z[0], z[1],
                            z[2]};
        for (int k = 0; k < 6; k++) j[k * arm.joints + i] = column[k];
    }
}

/* Joint rates [deg/s] for a twist in the base frame: J^T (J J^T + tiny)^-1 twist, by Gaussian elimination with pivoting */
static void rates_of(const double *twist, double *rates) {
    double j[42], a[6][7];
    int n = arm.joints;
    jacobian(j);
    for (int r = 0; r < 6; r++) {
        for (int c = 0; c < 6; c++) {
            a[r][c] = r == c ? 1e-10 : 0;
            for (int k = 0; k < n; k++) a[r][c] += j[r * n + k] * j[c * n + k];
        }
        a[r][6] = twist[r];
    }
    for (int p = 0; p < 6; p++) {
        int best = p;
        for (int r = p + 1; r < 6; r++)
            if (fabs(a[r][p]) > fabs(a[best][p])) best = r;
        for (int c = 0; c < 7; c++) {
            double swap = a[p][c];
            a[p][c] = a[best][c];
            a[best][c] = swap;
        }
        for (int r = 0; r < 6; r++) {
            if (r == p) continue;
            double factor = a[r][p] / a[p][p];
            for (int c = p; c < 7; c++) a[r][c] -= factor * a[p][c];
        }
    }
    double fastest = 1;
    for (int i = 0; i < n; i++) {
        rates[i] = 0;
        for (int r = 0; r < 6; r++) rates[i] += j[r * n + i] * a[r][6] / a[r][r];
        rates[i] *= 180 / M_PI;
        fastest = fmax(fastest, fabs(rates[i]) / arm.chain[i].speed);
    }
    for (int i = 0; i < n; i++) rates[i] /= fastest;
}

static double clamp(double value, double low, double high) { return value < low ? low : value > high ? high : value; }

static double in_range(int joint, double angle) {
    const Joint *j = &arm.chain[joint];
    return j->low == j->high ? angle : clamp(angle, j->low, j->high);
}

static int towards_joints(const double *target, double first, double others, double *rates) {
    int moving = 0;
    for (int i = 0; i < arm.joints; i++) {
        double speed = fmin(i < 3 ? first : others, arm.chain[i].speed);
        rates[i] = clamp((in_range(i, target[i]) - arm.q[i]) / CYCLE, -speed, speed);
        moving |= rates[i] != 0;
    }
    return moving;
}

static int move_fingers(const double *target) {
    int there = 1;
    for (int i = 0; i < 3; i++) {
        double to = clamp(target[i], 0, FINGER_CLOSED);
        arm.fingers[i] += clamp(to - arm.fingers[i], -FINGER_SPEED * CYCLE, FINGER_SPEED * CYCLE);
        there &= arm.fingers[i] == to;
    }
    return there;
}

static void pop(void) {
    arm.first = (arm.first + 1) % FIFO_SIZE;
    arm.count--;
}

static void follow(double *rates) {
    const TrajectoryPoint *point = &arm.fifo[arm.first];
    const UserPosition *to = &point->Position;
    if (to->Type == 8) arm.cartesian = 0; /* until it goes home: kinova-ros issue 269 */
    if (to->Type == 8)
        for (int i = 0; i < arm.joints; i++) rates[i] = clamp(to->Actuators.Actuator[i], -arm.chain[i].speed, arm.chain[i].speed);
    else if (to->Type == 7 && arm.cartesian) { /* else ignored, without a word */
        double twist[6] = {to->CartesianPosition.X,      to->CartesianPosition.Y,      to->CartesianPosition.Z,
                           0, 0, 0};
        const double *hand = arm.frames[arm.joints]; /* a point's rotation is in the end effector's frame */
        for (int i = 0; i < 3; i++)
            twist[3 + i] = hand[4 * i] * to->CartesianPosition.ThetaX + hand[4 * i + 1] * to->CartesianPosition.ThetaY +
                           hand[4 * i + 2] * to->CartesianPosition.ThetaZ;
        rates_of(twist, rates);
    }
    pop();
}

static void cycle(void) {
    double rates[7] = {0}, open[3] = {0};
    if (arm.control) {
        if (arm.homing) {
            arm.homing = towards_joints(arm.home, 20, 20, rates);
            if (!arm.homing) arm.homed = arm.cartesian = 1;
        } else if (arm.count)
            follow(rates);
        if (arm.opening) {
            arm.opening = !move_fingers(open);
            arm.fingers_ready = !arm.opening;
        }
    }
    for (int i = 0; i < arm.joints; i++) {
        double before = arm.q[i];
        arm.q[i] = in_range(i, before + rates[i] * CYCLE);
        arm.rates[i] = (arm.q[i] - before) / CYCLE;
    }
    forward();
}

static double clock_s(void) {
    struct timespec now;
    if (!real_time) return manual_s;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + now.tv_nsec * 1e-9;
}

/* Live through the cycles that have passed, then say whether the call may be made */
static int enter(const char *name, int needs_init) {
    double now = clock_s();
    while (now - lived_s >= CYCLE - 1e-9) {
        cycle();
        lived_s += CYCLE;
    }
    for (int i = 0; i < INJECTED_MAX; i++)
        if (injected[i].times && !strcmp(injected[i].name, name)) {
            injected[i].times--;
            return injected[i].code;
        }
    return needs_init && !arm.initialized ? NOT_INITIALIZED : OK;
}

#define ENTER(name)                                   \
    do {                                              \
        int code = enter(#name, 1);                   \
        if (code != OK) return code;                  \
    } while (0)
#define ENTER_WITHOUT_INIT(name)                      \
    do {                                              \
        int code = enter(#name, 0);                   \
        if (code != OK) return code;                  \
    } while (0)

/* For the tests --------------------------------------------------------------------------------------------------- */

void double_reset(int type, int cold) {
    memset(&arm, 0, sizeof arm);
    memset(injected, 0, sizeof injected);
    for (unsigned i = 0; i < sizeof MODELS / sizeof *MODELS; i++)
        if (MODELS[i].type == type) {
            arm.type = type;
            arm.joints = MODELS[i].joints;
            arm.name = MODELS[i].name;
            arm.chain = MODELS[i].chain;
            arm.home = MODELS[i].home;
        }
    arm.cold = cold;
    arm.homed = arm.cartesian = !cold;
    memcpy(arm.q, arm.home, sizeof arm.q);
    real_time = 0;
    lived_s = manual_s = 0;
    forward();
}

void double_real_time(int on) {
    real_time = on;
    lived_s = clock_s();
}

void double_advance(double seconds) {
    manual_s += seconds;
    enter("", 0);
}

void double_inject(const char *name, int code, int times) {
    for (int i = 0; i < INJECTED_MAX; i++)
        if (!injected[i].times) {
            strncpy(injected[i].name, name, sizeof injected[i].name - 1);
            injected[i].code = code;
            injected[i].times = times;
            return;
        }
}

void double_push(const double *wrench) { memcpy(arm.wrench, wrench, sizeof arm.wrench); }

void double_active_serial(char *out) { memcpy(out, arm.active.SerialNumber, 20); }

unsigned long double_robot_ip(void) { return arm.ethernet.robotIpAddress; }

int double_sizeof(const char *name) {
    static const struct { const char *name; int size; } sizes[] = {
        {"CartesianInfo", sizeof(CartesianInfo)},
        {"AngularInfo", sizeof(AngularInfo)},
        {"FingersPosition", sizeof(FingersPosition)},
        {"CartesianPosition", sizeof(CartesianPosition)},
        {"AngularPosition", sizeof(AngularPosition)},
        {"UserPosition", sizeof(UserPosition)},
        {"TrajectoryPoint", sizeof(TrajectoryPoint)},
        {"TrajectoryFIFO", sizeof(TrajectoryFIFO)},
        {"JoystickCommand", sizeof(JoystickCommand)},
        {"KinovaDevice", sizeof(KinovaDevice)},
        {"SensorsInfo", sizeof(SensorsInfo)},
        {"QuickStatus", sizeof(QuickStatus)},
        {"ForcesInfo", sizeof(ForcesInfo)},
        {"EthernetCommConfig", sizeof(EthernetCommConfig)},
        {"GeneralInformations", sizeof(GeneralInformations)},
        {"Zone", sizeof(Zone)},
        {"ZoneList", sizeof(ZoneList)},
    };
    for (unsigned i = 0; i < sizeof sizes / sizeof *sizes; i++)
        if (!strcmp(sizes[i].name, name)) return sizes[i].size;
    return -1;
}

/* The vendor's functions: the library and its devices ------------------------------------------------------------- */

int VENDOR(GetAPIVersion)(int version[3]) {
    ENTER_WITHOUT_INIT(GetAPIVersion);
    version[0] = 5, version[1] = 2, version[2] = 0;
    return OK;
}

#ifdef ETHERNET
int VENDOR(InitEthernetAPI)(EthernetCommConfig *config) {
    ENTER_WITHOUT_INIT(InitEthernetAPI);
    if (!config->robotIpAddress) return INVALID;
    arm.ethernet = *config;
    arm.initialized = 1;
    return OK;
}
#endif

int VENDOR(InitAPI)(void) {
    ENTER_WITHOUT_INIT(InitAPI);
    arm.initialized = 1;
    return OK;
}

int VENDOR(CloseAPI)(void) {
    ENTER_WITHOUT_INIT(CloseAPI);
    arm.initialized = 0;
    return OK;
}

int VENDOR(RefresDevicesList)(void) {
    ENTER(RefresDevicesList);
    return OK;
}

int VENDOR(GetDevices)(KinovaDevice devices[20], int *status) {
    int code = enter("GetDevices", 1);
    *status = code;
    if (code != OK) return 0;
    memset(&devices[0], 0, sizeof devices[0]);
    strcpy(devices[0].SerialNumber, "DOUBLE-1");
    strcpy(devices[0].Model, arm.name);
    devices[0].VersionMajor = 6, devices[0].VersionMinor = 2, devices[0].VersionRelease = 5;
    devices[0].DeviceType = arm.type;
    return 1;
}

int VENDOR(SetActiveDevice)(KinovaDevice device) {
    ENTER(SetActiveDevice);
    if (strncmp(device.SerialNumber, "DOUBLE-1", 20)) return NO_DEVICE;
    arm.active = device;
    return OK;
}

int VENDOR(GetGeneralInformations)(GeneralInformations *out) {
    ENTER(GetGeneralInformations);
    out->TimeFromStartup = lived_s;
    out->SupplyVoltage = 24;
    out->ConnectedActuatorCount = (unsigned short)arm.joints;
    return OK;
}

int VENDOR(GetSystemErrorCount)(unsigned int *count) {
    ENTER(GetSystemErrorCount);
    *count = 0;
    return OK;
}

int VENDOR(ClearErrorLog)(void) {
    ENTER(ClearErrorLog);
    return OK;
}

/* Control and motion ---------------------------------------------------------------------------------------------- */

int VENDOR(StartControlAPI)(void) {
    ENTER(StartControlAPI);
    arm.control |= !arm.cold;
    arm.cold = 0;
    return OK;
}

int VENDOR(StopControlAPI)(void) {
    ENTER(StopControlAPI);
    arm.control = arm.homing = arm.opening = 0;
    return OK;
}

int VENDOR(SetFrameType)(int frame) {
    ENTER(SetFrameType);
    return frame ? INVALID : OK;
}

static int queue(const TrajectoryPoint *point) {
    int type = point->Position.Type;
    if (type != 7 && type != 8) return INVALID;
    if (!arm.control) return OK;
    if (arm.count == FIFO_SIZE) return NACK;
    arm.homing = arm.opening = 0;
    arm.fifo[(arm.first + arm.count++) % FIFO_SIZE] = *point;
    return OK;
}

int VENDOR(SendBasicTrajectory)(TrajectoryPoint point) {
    ENTER(SendBasicTrajectory);
    return queue(&point);
}

int VENDOR(EraseAllTrajectories)(void) {
    ENTER(EraseAllTrajectories);
    arm.count = arm.homing = arm.opening = 0;
    return OK;
}

int VENDOR(GetGlobalTrajectoryInfo)(TrajectoryFIFO *out) {
    ENTER(GetGlobalTrajectoryInfo);
    out->TrajectoryCount = (unsigned)arm.count;
    out->UsedPercentage = 100.f * (float)arm.count / FIFO_SIZE;
    out->MaxSize = FIFO_SIZE;
    return OK;
}

int VENDOR(SendJoystickCommand)(JoystickCommand command) {
    ENTER(SendJoystickCommand);
    (void)command;
    return OK;
}

int VENDOR(GetJoystickValue)(JoystickCommand *out) {
    ENTER(GetJoystickValue);
    (void)out;
    return OK;
}

int VENDOR(MoveHome)(void) {
    ENTER(MoveHome);
    arm.count = arm.opening = 0;
    arm.homing = 1;
    return OK;
}

int VENDOR(InitFingers)(void) {
    ENTER(InitFingers);
    arm.opening = 1;
    return OK;
}

int VENDOR(SetEndEffectorOffset)(unsigned int status, float x, float y, float z) {
    ENTER(SetEndEffectorOffset);
    (void)status;
    return x != 0 || y != 0 || z != 0 ? INVALID : OK;
}

/* Readings -------------------------------------------------------------------------------------------------------- */

/* As the arm does: joint 7 of a six-joint arm is not written */
static void write_joints(AngularPosition *out, const double *values) {
    for (int i = 0; i < arm.joints; i++) out->Actuators.Actuator[i] = (float)values[i];
}

static void write_fingers(FingersPosition *out) {
    for (int i = 0; i < 3; i++) out->Finger[i] = (float)arm.fingers[i];
}

static void torques(double *out) {
    double j[42];
    jacobian(j);
    for (int i = 0; i < arm.joints; i++) {
        out[i] = 0;
        for (int k = 0; k < 6; k++) out[i] += j[k * arm.joints + i] * arm.wrench[k];
    }
}

static void write_wrench(CartesianInfo *out) {
    float *values = &out->X;
    for (int i = 0; i < 6; i++) values[i] = (float)arm.wrench[i];
}

int VENDOR(GetAngularPosition)(AngularPosition *out) {
    ENTER(GetAngularPosition);
    write_joints(out, arm.q);
    write_fingers(&out->Fingers);
    return OK;
}

/* As the firmware does: half of the true rate, 181 to 360 for what is negative, and not near zero at rest */
int VENDOR(GetAngularVelocity)(AngularPosition *out) {
    double shown[7];
    ENTER(GetAngularVelocity);
    for (int i = 0; i < arm.joints; i++) {
        shown[i] = .5 * arm.rates[i] + 1.5 * sin(7.3 * i + 41 * lived_s);
        if (shown[i] < 0) shown[i] += 360;
    }
    write_joints(out, shown);
    return OK;
}

/* gravity is not modelled here, so that both torques are those of the push alone */
int VENDOR(GetAngularForce)(AngularPosition *out) {
    double torque[7];
    ENTER(GetAngularForce);
    torques(torque);
    write_joints(out, torque);
    return OK;
}

int VENDOR(GetAngularForceGravityFree)(AngularPosition *out) {
    double torque[7];
    ENTER(GetAngularForceGravityFree);
    torques(torque);
    write_joints(out, torque);
    return OK;
}

int VENDOR(GetAngularCurrent)(AngularPosition *out) {
    double current[7];
    ENTER(GetAngularCurrent);
    torques(current);
    for (int i = 0; i < arm.joints; i++) current[i] = .1 + fabs(current[i]) / 20;
    write_joints(out, current);
    return OK;
}

static void write_pose(CartesianPosition *out) {
    const double *f = arm.frames[arm.joints];
    double x = atan2(-f[6], f[10]), y = asin(clamp(f[2], -1, 1)), z = atan2(-f[1], f[0]);
    CartesianInfo pose = {(float)f[3], (float)f[7], (float)f[11], (float)x, (float)y, (float)z};
    out->Coordinates = pose;
    write_fingers(&out->Fingers);
}

int VENDOR(GetCartesianPosition)(CartesianPosition *out) {
    ENTER(GetCartesianPosition);
    write_pose(out);
    return OK;
}

int VENDOR(GetCartesianCommand)(CartesianPosition *out) {
    ENTER(GetCartesianCommand);
    write_pose(out);
    return OK;
}

int VENDOR(GetCartesianForce)(CartesianPosition *out) {
    ENTER(GetCartesianForce);
    write_wrench(&out->Coordinates);
    return OK;
}

int VENDOR(GetCommandVelocity)(float cartesian[6], float angular[7]) {
    double j[42];
    ENTER(GetCommandVelocity);
    jacobian(j);
    for (int r = 0; r < 6; r++) {
        double sum = 0;
        for (int i = 0; i < arm.joints; i++) sum += j[r * arm.joints + i] * arm.rates[i] * M_PI / 180;
        cartesian[r] = (float)sum;
    }
    for (int i = 0; i < arm.joints; i++) angular[i] = (float)arm.rates[i];
    return OK;
}

int VENDOR(GetForcesInfo)(ForcesInfo *out) {
    double torque[7];
    ENTER(GetForcesInfo);
    torques(torque);
    for (int i = 0; i < arm.joints; i++) out->Actuator[i] = (float)torque[i];
    write_wrench(&out->Cartesian);
    return OK;
}

int VENDOR(GetSensorsInfo)(SensorsInfo *out) {
    ENTER(GetSensorsInfo);
    out->Voltage = 24;
    out->Current = 1.5f;
    out->Acceleration[2] = 1;
    for (int i = 0; i < arm.joints; i++) out->ActuatorTemp[i] = 30;
    for (int i = 0; i < 3; i++) out->FingerTemp[i] = 28;
    return OK;
}

int VENDOR(GetQuickStatus)(QuickStatus *out) {
    ENTER(GetQuickStatus);
    memset(out, 0, sizeof *out);
    memset(out->FingerStatus, arm.fingers_ready, 3);
    out->ControlEnableStatus = !arm.control;
    out->ForceControlStatus = 1;
    out->TorqueSensorsStatus = 1;
    int away = 0;
    for (int i = 0; i < arm.joints; i++) away |= fabs(arm.q[i] - arm.home[i]) >= .5;
    out->RetractType = arm.homing ? 0 : !arm.homed ? 6 : away ? 5 : 1;
    return OK;
}

/* Force ----------------------------------------------------------------------------------------------------------- */

int VENDOR(StopForceControl)(void) {
    ENTER(StopForceControl);
    return OK;
}

static ZoneList zones; /* kept, and here not obeyed: no motion by joints keeps to them */

int VENDOR(EraseAllProtectionZones)(void) {
    ENTER(EraseAllProtectionZones);
    memset(&zones, 0, sizeof zones);
    return OK;
}

int VENDOR(SetProtectionZone)(ZoneList given) {
    ENTER(SetProtectionZone);
    if (given.NbZones < 0 || given.NbZones > 10) return INVALID;
    zones = given;
    return OK;
}

int VENDOR(GetProtectionZone)(ZoneList *out) {
    ENTER(GetProtectionZone);
    *out = zones;
    return OK;
}

int VENDOR(SetTorqueSafetyFactor)(float factor) {
    ENTER(SetTorqueSafetyFactor);
    return factor >= 0 && factor <= 1 ? OK : INVALID;
}

int VENDOR(SetGravityType)(int type) {
    ENTER(SetGravityType);
    return type == 0 || type == 1 ? OK : INVALID;
}

int VENDOR(SetGravityPayload)(float payload[4]) {
    ENTER(SetGravityPayload);
    (void)payload;
    return OK;
}
