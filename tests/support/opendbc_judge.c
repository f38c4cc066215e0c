#include <math.h>
#include <stdlib.h>
#include "opendbc/safety/tests/libsafety/fake_stm.h"
#include "opendbc/safety/can.h"
#include "opendbc/safety/safety.h"

static void before(int last, double v) {
  controls_allowed = true;
  desired_angle_last = last;
  int code = (int)(v * VEHICLE_SPEED_FACTOR + 0.5);
  vehicle_speed.min = code;
  vehicle_speed.max = code;
  for (int i = 0; i < MAX_SAMPLE_VALS; i++) vehicle_speed.values[i] = code;
  angle_meas.min = angle_meas.max = last;
  for (int i = 0; i < MAX_SAMPLE_VALS; i++) angle_meas.values[i] = last;
}

/* Angle cars with a model of the car; rejected[i] says whether command i may not pass. */
void judge_model(int n, const int *angle, const int *last, const double *v, int frequency, double per_deg,
                 double slip, double ratio, double wheelbase, unsigned char *rejected) {
  const AngleSteeringLimits limits = {.angle_deg_to_can = per_deg, .frequency = frequency, .max_angle = 100000000};
  const AngleSteeringParams params = {.slip_factor = slip, .steer_ratio = ratio, .wheelbase = wheelbase};
  for (int i = 0; i < n; i++) {
    before(last[i], v[i]);
    rt_angle_msgs = 0;
    rejected[i] = steer_angle_cmd_checks_vm(angle[i], true, limits, params);
  }
}

/* Cars with a table of rates: angles, or curvatures with a limit on the lateral acceleration. */
void judge_table(int n, const int *angle, const int *last, const double *v, const double *rate, double per_unit,
                 int most, int curvature, unsigned char *rejected) {
  for (int i = 0; i < n; i++) {
    const AngleSteeringLimits limits = {
      .max_angle = most, .angle_deg_to_can = per_unit, .max_angle_error = 2 * most, .enforce_angle_error = true,
      .angle_rate_up_lookup = {{0., 1., 2.}, {rate[i], rate[i], rate[i]}},
      .angle_rate_down_lookup = {{0., 1., 2.}, {rate[i], rate[i], rate[i]}},
      .angle_is_curvature = curvature};
    before(last[i], v[i]);
    rejected[i] = steer_angle_cmd_checks(angle[i], true, limits);
  }
}

/* How many of n frames at these times [us] come too often. */
int judge_rate(int n, const unsigned int *when, int frequency) {
  const AngleSteeringLimits limits = {.frequency = frequency};
  int wrong = 0;
  rt_angle_msgs = 0;
  ts_angle_check_last = timer_cnt = when[0];
  for (int i = 0; i < n; i++) {
    timer_cnt = when[i];
    wrong += rt_angle_rate_limit_check(limits);
  }
  return wrong;
}
