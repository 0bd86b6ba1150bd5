/* A battery electric car with one gear, one step of the hybrid backward/forward method, written by hand.

   It is the plain counterpart of the generated step: the same physics from the same equations, without the library that
   generates code.  Numbers and maps come from the caller; all quantities are SI, power toward the wheel is positive.
   Equations with a number in brackets are those of Wipke, Cuddy and Burch (1999). */

#include <math.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* One list serves the fields of a struct and the names that the caller sees. */
#define FIELD(part, name) double part##_##name;
#define NAME(part, name) #part "." #name,

#define PARAMETERS(X) \
  X(body, m) X(body, c_d) X(body, A) X(body, rho) X(body, g) X(body, front_share) X(body, h) X(body, wheelbase) \
  X(body, v_miss) X(body, v_start) \
  X(wheel, r) X(wheel, J) X(wheel, f_0) X(wheel, f_1) X(wheel, mu_max) X(wheel, front_driven) X(wheel, rear_driven) \
  X(wheel, F_brake_front_max) X(wheel, F_brake_rear_max) \
  X(final_drive, i) X(final_drive, tau_loss) X(final_drive, J) \
  X(gearbox, ratios_1) X(gearbox, J) X(gearbox, speed_scale) X(gearbox, torque_scale) X(gearbox, efficiency_scale) \
  X(motor, omega_max) X(motor, J) X(motor, overtorque) X(motor, I_max) X(motor, U_min) X(motor, speed_scale) \
  X(motor, torque_scale) X(motor, efficiency_scale) \
  X(accessories, P_on) X(accessories, eta) \
  X(battery, n_modules) X(battery, u_min) X(battery, u_max) X(battery, capacity_scale) X(battery, soc_start) \
  X(battery, T_start) X(battery, T_ambient) X(battery, T_fan) X(battery, mass) X(battery, c_p) X(battery, R_th_fan) \
  X(battery, R_th_still) X(battery, airflow)

#define MAPS(X) \
  X(wheel, slip) X(wheel, tau_bearing) X(wheel, share_driveline) X(wheel, share_front) X(gearbox, efficiency) \
  X(motor, P_electric) X(motor, tau_max) X(motor, tau_min) \
  X(battery, u_oc) X(battery, r_discharge) X(battery, r_charge) X(battery, Q) X(battery, eta_coulomb)

#define STATES(X) \
  X(body, v) X(body, distance) X(body, elevation) X(body, trace_missed) X(body, speed_ratio) X(wheel, omega_before) \
  X(gearbox, torque_ratio) X(motor, omega_before) X(battery, soc) X(battery, T) X(battery, U_supply)

#define OUTPUTS(X) \
  X(body, v) X(body, distance) X(body, elevation) X(body, v_request) X(body, F_required) X(body, v_mean) \
  X(body, trace_miss) X(body, P_aero) X(body, P_roll) X(body, P_climb) X(body, P_kinetic) X(body, P_mismatch) \
  X(body, P_limit) X(body, a_request) X(body, P_in) \
  X(wheel, F_limited) X(wheel, v_limited) X(wheel, slip_limited) X(wheel, slip) X(wheel, F_brake_front) \
  X(wheel, F_brake_rear) X(wheel, F_friction_required) X(wheel, F_driveline_required) X(wheel, v_driveline) \
  X(wheel, P_brake) X(wheel, P_slip) X(wheel, P_bearing) X(wheel, P_kinetic) X(wheel, P_discretisation) X(wheel, F) \
  X(wheel, F_required) X(wheel, v) X(wheel, v_required) X(wheel, P_out) X(wheel, P_in) \
  X(final_drive, P_loss) X(final_drive, P_kinetic) X(final_drive, P_discretisation) X(final_drive, tau) \
  X(final_drive, tau_required) X(final_drive, omega) X(final_drive, omega_required) X(final_drive, P_out) \
  X(final_drive, P_in) \
  X(gearbox, P_loss) \
  X(gearbox, P_kinetic) X(gearbox, P_discretisation) X(gearbox, tau) X(gearbox, tau_required) X(gearbox, omega) \
  X(gearbox, omega_required) X(gearbox, P_out) X(gearbox, P_in) \
  X(motor, tau_limited) X(motor, throttle_motor) X(motor, P_map) X(motor, P_loss) X(motor, P_kinetic) \
  X(motor, P_discretisation) X(motor, P_mismatch) X(motor, tau) X(motor, tau_required) X(motor, omega) X(motor, omega_required) \
  X(motor, P_out) X(motor, P_in) X(motor, P_in_required) \
  X(accessories, P_loss) X(accessories, P_out) X(accessories, P_in) X(accessories, P_in_required) \
  X(bus, P_bus) X(bus, P_loss) X(bus, P_out) X(bus, P_in) X(bus, P_in_required) \
  X(battery, soc) X(battery, T) X(battery, U) X(battery, I) X(battery, P_stored) X(battery, P_loss) \
  X(battery, P_battery_max) X(battery, P_battery_min) X(battery, battery_limited) X(battery, P_out)

/* Piecewise linear over one axis (ny = 0) or two; i and j remember where the last look-up was. */
typedef struct {
  long nx, ny;
  const double *x, *y, *value;
  long i, j;
} map;

#define MAP_FIELD(part, name) map part##_##name;

typedef struct { PARAMETERS(FIELD) } parameters;
typedef struct { MAPS(MAP_FIELD) } maps;
typedef struct { STATES(FIELD) } states;
typedef struct { OUTPUTS(FIELD) } outputs;

EXPORT const char *twin_parameters[] = {PARAMETERS(NAME) 0};
EXPORT const char *twin_maps[] = {MAPS(NAME) 0};
EXPORT const char *twin_states[] = {STATES(NAME) 0};
EXPORT const char *twin_outputs[] = {OUTPUTS(NAME) 0};

enum { N_OUTPUTS = sizeof(outputs) / sizeof(double) };

static double smaller(double a, double b) { return a < b ? a : b; }
static double larger(double a, double b) { return a > b ? a : b; }
static double between(double x, double low, double high) { return smaller(larger(x, low), high); }

/* From one step to the next most arguments move little: walk from the last interval. */
static long interval(const double *x, long n, double at, long i) {
  while (i < n - 2 && at >= x[i + 1]) ++i;
  while (i > 0 && at < x[i]) --i;
  return i;
}

static double extended(map *m, double x) {
  long i = m->i = interval(m->x, m->nx, x, m->i);
  return m->value[i] + (m->value[i + 1] - m->value[i]) * (x - m->x[i]) / (m->x[i + 1] - m->x[i]);
}

static double clipped(map *m, double x) { return extended(m, between(x, m->x[0], m->x[m->nx - 1])); }

static double extended_2d(map *m, double x, double y) {
  long i = m->i = interval(m->x, m->nx, x, m->i), j = m->j = interval(m->y, m->ny, y, m->j);
  double s = (x - m->x[i]) / (m->x[i + 1] - m->x[i]), t = (y - m->y[j]) / (m->y[j + 1] - m->y[j]);
  const double *a = m->value + i * m->ny + j, *b = a + m->ny;
  return (1 - s) * ((1 - t) * a[0] + t * a[1]) + s * ((1 - t) * b[0] + t * b[1]);
}

static double clipped_2d(map *m, double x, double y) {
  return extended_2d(m, between(x, m->x[0], m->x[m->nx - 1]), between(y, m->y[0], m->y[m->ny - 1]));
}

static double slip_of(maps *t, double F, double W) {
  double slip = clipped(&t->wheel_slip, fabs(F) / larger(W, 1e-3));
  return F > 0 ? slip : F < 0 ? -slip : 0;
}

static void step(const parameters *p, maps *t, const states *x, double v_request, double grade, double key_on, double dt,
                 states *xn, outputs *o) {
  const double v = x->body_v, m = p->body_m, r = p->wheel_r;

  /* Body, required: force and mean speed that reach the request. */
  const double cosine = 1 / sqrt(1 + grade * grade), W = m * p->body_g * cosine;
  const double roll_0 = W * p->wheel_f_0, roll_1 = W * p->wheel_f_1, climb = W * grade;
  const double aero = 0.5 * p->body_rho * p->body_c_d * p->body_A;
  const double v_asked = 0.5 * (v + v_request), a_asked = (v_request - v) / dt;
  /* Standing, and asked to stand: held by the brakes. */
  const double F_asked = v_asked > 0 ? m * a_asked + roll_0 + roll_1 * v_asked + climb + aero * v_asked * v_asked : 0;

  /* Grip of the driven axle, eq. 2 and 3; drag with v_end^2 ~ v v_end. */
  const double fd = p->wheel_front_driven, rd = p->wheel_rear_driven, front = p->body_front_share;
  const double grip = p->wheel_mu_max * W * (fd * front + rd * (1 - front));
  const double transfer = p->wheel_mu_max * p->body_h / p->body_wheelbase * (fd - rd);
  const double momentum = m * v / dt;
  const double rest = momentum - roll_0 - climb - 0.5 * roll_1 * v - 0.25 * aero * v * v;
  const double slope = 0.75 * aero * v + 0.5 * roll_1 + m / dt;
  const double v_highest = (grip - transfer * climb + rest + transfer * momentum) / (slope + transfer * m / dt);
  const double v_lowest = (-grip + transfer * climb + rest - transfer * momentum) / (slope - transfer * m / dt);
  const double v_limited = between(v_asked, 0.5 * (v_lowest + v), 0.5 * (v_highest + v));
  const double shifted = p->body_h / p->body_wheelbase * (2 * m * (v_limited - v) / dt + climb);
  const double W_driven = fd * (front * W - shifted) + rd * ((1 - front) * W + shifted);
  const double F_max = p->wheel_mu_max * W_driven, F_limited = between(F_asked, -F_max, F_max);

  /* Wheel and axle, required, eq. 1, 4 and 5: the driveline takes its share of a braking force. */
  double F_driveline_asked = F_limited, F_driven_asked = F_limited;
  if (F_limited < 0) {
    double share = clipped(&t->wheel_share_driveline, v_asked), share_front = clipped(&t->wheel_share_front, v_asked);
    double share_rear = between(1 - share - share_front, 0, 1);
    F_driveline_asked = F_limited * share;
    F_driven_asked = F_limited * (1 - (1 - fd) * share_front - (1 - rd) * share_rear);
  }
  const double slip = slip_of(t, F_driven_asked, W_driven);
  const double omega_w = v_limited * (1 + slip) / r, alpha_w = (omega_w - x->wheel_omega_before) / dt;
  const double tau_bearing = omega_w > 0 ? extended(&t->wheel_tau_bearing, m) : 0, tau_wheels = p->wheel_J * alpha_w;
  const double tau_axle = F_driveline_asked * r + tau_bearing + tau_wheels;

  /* Final drive, required. */
  const double i = p->final_drive_i, omega_f = omega_w * i, alpha_f = alpha_w * i;
  const double drag_f = omega_f > 0 ? p->final_drive_tau_loss : 0, tau_f_rotor = p->final_drive_J * alpha_f;
  const double tau_f = tau_axle / i + drag_f + tau_f_rotor;

  /* Gearbox, required: the efficiency of the output point.  The map says nothing near standstill. */
  const double G = p->gearbox_ratios_1, omega_g = omega_f * G, alpha_g = alpha_f * G;
  double drag_g = 0;
  if (omega_f > 0) {
    double speed = larger(omega_f, 5) / p->gearbox_speed_scale;
    double e = p->gearbox_efficiency_scale * clipped_2d(&t->gearbox_efficiency, speed, tau_f / p->gearbox_torque_scale);
    e = between(e, 0.05, 1);
    drag_g = (tau_f >= 0 ? tau_f * (1 - e) / e : -tau_f * (1 - e)) / G;
  }
  const double tau_mesh = tau_f / G + drag_g, tau_g_rotor = p->gearbox_J * alpha_g, tau_g = tau_mesh + tau_g_rotor;

  /* Motor and controller, required, eq. 6 to 10. */
  const double top = p->motor_omega_max * p->motor_speed_scale;
  const double omega_m = between(omega_g, 0, top), tau_m_rotor = p->motor_J * alpha_g, tau_m = tau_g + tau_m_rotor;
  const double omega_map = x->body_trace_missed ? smaller(x->motor_omega_before * x->body_speed_ratio, top) : omega_m;
  const double at = omega_map / p->motor_speed_scale, torque = p->motor_overtorque * p->motor_torque_scale;
  const double lowest = torque * extended(&t->motor_tau_min, at), highest = torque * extended(&t->motor_tau_max, at);
  const double tau_limited = tau_m >= 0 ? smaller(tau_m, highest) : larger(tau_m, lowest);
  double P_map = 0;
  if (omega_m > 1e-3) {
    P_map = p->motor_speed_scale * p->motor_torque_scale * extended_2d(&t->motor_P_electric, at, tau_limited / p->motor_torque_scale);
    P_map = P_map >= 0 ? P_map / p->motor_efficiency_scale : P_map * p->motor_efficiency_scale;
  }
  const double P_current = p->motor_I_max * x->battery_U_supply, P_motor_asked = between(P_map, -P_current, P_current);
  /* The throttle is measured at the speed that the shaft asks for. */
  const double there = omega_m / p->motor_speed_scale;
  const double full = tau_limited >= 0 ? extended(&t->motor_tau_max, there) : -extended(&t->motor_tau_min, there);

  /* Accessories and bus, required. */
  const double P_accessories = key_on ? p->accessories_P_on / p->accessories_eta : 0, P_bus = P_motor_asked + P_accessories;

  /* Battery: limits, then the current at the terminal power. */
  const double N = p->battery_n_modules, scale = N / p->battery_capacity_scale, soc = x->battery_soc, T = x->battery_T;
  const double U_oc = N * clipped_2d(&t->battery_u_oc, T, soc);
  const double R_dis = scale * clipped_2d(&t->battery_r_discharge, T, soc), R_chg = scale * clipped_2d(&t->battery_r_charge, T, soc);
  const double U_min = larger(larger(0.5 * U_oc, p->motor_U_min), N * p->battery_u_min);
  const double I_min = smaller(0, (U_oc - N * p->battery_u_max) / R_chg);
  const double P_max = soc > 1e-3 ? larger(0, (U_oc - U_min) * U_min / R_dis) : 0;
  const double P_min = soc < 0.999 ? I_min * (U_oc - I_min * R_chg) : 0;
  const double P_cut = soc >= 0.999 && P_bus < 0 ? 0 : smaller(P_bus, P_max), R = P_bus >= 0 ? R_dis : R_chg;
  const double I_cut = 2 * P_cut / (U_oc + sqrt(larger(U_oc * U_oc - 4 * R * P_cut, 0)));
  const double I = larger(I_cut, I_min), U = U_oc - R * I;
  const int battery_limited = P_cut != P_bus || I_cut < I_min;
  const double P_battery = battery_limited ? U * I : P_bus;
  const double eta = I >= 0 ? 1 : clipped(&t->battery_eta_coulomb, T);
  const double P_stored = U_oc * eta * I, P_heat = P_stored - U * I;
  const double R_th = T > p->battery_T_fan ? p->battery_R_th_fan + 1 / (2 * p->battery_airflow * 1009) : p->battery_R_th_still;

  /* Bus and accessories, available: these are served first, with what the bus and a braking motor bring. */
  const double P_given = smaller(P_battery, larger(P_bus, 0));
  const double P_served = between(P_given - smaller(P_motor_asked, 0), 0, P_accessories), P_motor = P_given - P_served;

  /* Motor, available, eq. 11; the ratio stays between 0 and 1. */
  const double ratio = P_map != 0 ? between(P_motor / P_map, 0, 1) : 0;
  const double tau_drive = tau_limited * ratio, tau_motor = tau_drive - tau_m_rotor;

  /* Gearbox, available: the same ratio of torques, or the same loss where that says nothing. */
  const double tau_offered = tau_motor - tau_g_rotor;
  const int useful = tau_f * tau_mesh > 0;
  const double tau_gearbox = useful ? tau_f * tau_offered / tau_mesh : tau_f + G * (tau_offered - tau_mesh);
  const double omega_gearbox = omega_m / G;
  const double ratio_speed = tau_f * omega_f / (omega_g > 0 ? omega_g : 1);

  /* Final drive, available. */
  const double tau_final = (tau_gearbox - tau_f_rotor - drag_f) * i, omega_final = omega_gearbox / i;

  /* Wheel, available, eq. 12: friction brakes make up what the request still needs. */
  const double F_driveline = (tau_final - tau_wheels - tau_bearing) / r, v_tread = r * omega_final;
  const double F_friction = F_asked < 0 ? smaller(0, F_asked - F_driveline) : 0;
  double share_front = 0.6;
  const double share = clipped(&t->wheel_share_driveline, v_asked);
  if (share < 1) share_front = between(clipped(&t->wheel_share_front, v_asked) / larger(1 - share, 1e-12), 0, 1);
  const double F_front = larger(share_front * F_friction, -p->wheel_F_brake_front_max);
  const double F_rear = larger(smaller(0, F_friction - F_front), -p->wheel_F_brake_rear_max);
  const double F = F_driveline + F_front + F_rear;
  const double F_driven = F_driveline + (fd ? F_front : 0) + (rd ? F_rear : 0);
  const double v_driveline = v_tread / (1 + slip_of(t, F_driven, W_driven));
  const double v_offered = fabs(omega_w - omega_final) > 1e-3 ? v_driveline : v_limited;

  /* Body, available: the mean speed that the force gives, then the end speed. */
  const double moves = v_offered > 0 ? 1 : 0;
  const double B = 2 * m / dt + roll_1 * moves;
  const double C = -2 * m * v / dt - larger(F, -70 * m) + roll_0 * moves + climb;
  const double v_force = -2 * C / (B + sqrt(larger(B * B - 4 * aero * C, 0)));
  const int braking = F < -m && v_request < v;
  double v_end = 2 * (braking ? larger(v_force, v_offered) : smaller(v_force, v_offered)) - v;
  if (v_end < 1e-9) v_end = 0;
  const double v_mean = 0.5 * (v + v_end), inertial = m * (v_end - v) / dt;
  const double F_used = inertial + moves * (roll_0 + roll_1 * v_mean) + climb + aero * v_mean * v_mean;

  xn->body_v = v_end;
  xn->body_distance = x->body_distance + v_mean * dt;
  xn->body_elevation = x->body_elevation + v_mean * dt * grade * cosine;
  xn->body_trace_missed = v_request - v_end > p->body_v_miss;
  xn->body_speed_ratio = v_driveline > 0 ? v_end / larger(v_driveline, 1e-12) : 0;
  xn->wheel_omega_before = omega_w;
  xn->gearbox_torque_ratio = ratio_speed * tau_mesh > 0 ? ratio_speed / tau_mesh : 0;
  xn->motor_omega_before = omega_m;
  xn->battery_soc = soc - dt * eta * I / (p->battery_capacity_scale * clipped(&t->battery_Q, T));
  xn->battery_T = T + dt * (P_heat / N - (T - p->battery_T_ambient) / R_th) / (p->battery_mass * p->battery_c_p);
  xn->battery_U_supply = U;

  o->body_v = xn->body_v;
  o->body_distance = xn->body_distance;
  o->body_elevation = xn->body_elevation;
  o->body_v_request = v_request;
  o->body_F_required = o->wheel_F_required = F_asked;
  o->body_v_mean = v_mean;
  o->body_trace_miss = v_request - v_end;
  o->body_P_aero = aero * v_mean * v_mean * v_mean;
  o->body_P_roll = moves * (roll_0 + roll_1 * v_mean) * v_mean;
  o->body_P_climb = climb * v_mean;
  o->body_P_kinetic = inertial * v_mean;
  o->body_P_mismatch = F * (v_offered - v_mean);
  o->body_P_limit = (F - F_used) * v_mean;
  o->body_a_request = a_asked;
  o->body_P_in = o->wheel_P_out = F * v_offered;

  o->wheel_F_limited = F_limited;
  o->wheel_v_limited = v_limited;
  o->wheel_slip_limited = F_limited != F_asked;
  o->wheel_slip = slip;
  o->wheel_F_brake_front = F_front;
  o->wheel_F_brake_rear = F_rear;
  o->wheel_F_friction_required = F_limited - F_driveline_asked;
  o->wheel_F_driveline_required = F_driveline_asked;
  o->wheel_v_driveline = v_driveline;
  /* A brake on the driven axle turns with its wheels, one on the other axle with the road. */
  o->wheel_P_brake = (F_driveline - F_driven) * v_tread + (F_driven - F) * v_offered;
  o->wheel_P_slip = F_driven * (v_tread - v_offered);
  o->wheel_P_bearing = tau_bearing * omega_final;
  o->wheel_P_kinetic = tau_wheels * (omega_w - 0.5 * alpha_w * dt);
  o->wheel_P_discretisation = tau_wheels * omega_final - o->wheel_P_kinetic;
  o->wheel_F = F;
  o->wheel_v = v_offered;
  o->wheel_v_required = v_asked;
  o->wheel_P_in = o->final_drive_P_out = tau_final * omega_final;

  o->final_drive_P_kinetic = tau_f_rotor * (omega_f - 0.5 * alpha_f * dt);
  o->final_drive_P_discretisation = tau_f_rotor * omega_gearbox - o->final_drive_P_kinetic;
  o->final_drive_P_loss = drag_f * omega_gearbox;
  o->final_drive_tau = tau_final;
  o->final_drive_tau_required = tau_axle;
  o->final_drive_omega = omega_final;
  o->final_drive_omega_required = omega_w;
  o->final_drive_P_in = o->gearbox_P_out = tau_gearbox * omega_gearbox;

  o->gearbox_tau_required = tau_f;
  o->gearbox_omega_required = omega_f;
  o->gearbox_P_kinetic = tau_g_rotor * (omega_g - 0.5 * alpha_g * dt);
  o->gearbox_P_discretisation = tau_g_rotor * omega_m - o->gearbox_P_kinetic;
  o->gearbox_P_loss = tau_offered * omega_m - tau_gearbox * omega_gearbox;
  o->gearbox_tau = tau_gearbox;
  o->gearbox_omega = omega_gearbox;
  o->gearbox_P_in = o->motor_P_out = tau_motor * omega_m;

  o->motor_tau_limited = tau_limited;
  o->motor_throttle_motor = between(tau_limited / larger(torque * full, 1e-9), -1, 1);
  o->motor_P_map = P_map;
  o->motor_P_kinetic = tau_m_rotor * (omega_m - 0.5 * alpha_g * dt);
  o->motor_P_discretisation = tau_m_rotor * omega_m - o->motor_P_kinetic;
  /* After a miss the map is read at an estimate of the speed; what lies between the two speeds is no heat. */
  o->motor_P_mismatch = tau_drive * (omega_map - omega_m);
  o->motor_P_loss = P_motor - tau_drive * omega_map;
  o->motor_tau = tau_motor;
  o->motor_tau_required = tau_g;
  o->motor_omega = omega_m;
  o->motor_omega_required = omega_g;
  o->motor_P_in = o->accessories_P_out = P_motor;
  o->motor_P_in_required = P_motor_asked;

  o->accessories_P_loss = P_served;
  o->accessories_P_in = o->bus_P_out = P_given;
  o->accessories_P_in_required = o->bus_P_bus = o->bus_P_in_required = P_bus;
  o->bus_P_loss = P_battery - P_given;
  o->bus_P_in = o->battery_P_out = P_battery;

  o->battery_soc = xn->battery_soc;
  o->battery_T = xn->battery_T;
  o->battery_U = U;
  o->battery_I = I;
  o->battery_P_stored = P_stored;
  o->battery_P_loss = P_heat;
  o->battery_P_battery_max = P_max;
  o->battery_P_battery_min = P_min;
  o->battery_battery_limited = battery_limited;
}

/* Drive n steps.  `history` holds n rows of outputs; `sums` and `highest`, unless null, get their time integrals and
   maxima. */
EXPORT void twin_march(long n, const double *dt, const double *v, const double *grade, const double *key_on,
                       const parameters *p, maps *t, outputs *history, double *sums, double *highest) {
  states x[2] = {{0}};
  x[0].body_v = p->body_v_start;
  x[0].wheel_omega_before = p->body_v_start / p->wheel_r;
  x[0].battery_soc = p->battery_soc_start;
  x[0].battery_T = p->battery_T_start;
  x[0].battery_U_supply = p->battery_n_modules * clipped_2d(&t->battery_u_oc, p->battery_T_start, p->battery_soc_start);
  for (int j = 0; sums && j < N_OUTPUTS; ++j) { sums[j] = 0; highest[j] = -HUGE_VAL; }
  for (long k = 0; k < n; ++k) {
    step(p, t, &x[k % 2], v[k], grade[k], key_on[k], dt[k], &x[(k + 1) % 2], &history[k]);
    const double *y = (const double *)&history[k];
    for (int j = 0; sums && j < N_OUTPUTS; ++j) {
      sums[j] += y[j] * dt[k];
      highest[j] = larger(y[j], highest[j]);
    }
  }
}
