#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "opendbc/safety/tests/libsafety/fake_stm.h"
#include "opendbc/safety/can.h"
#include "opendbc/safety/safety.h"

static int code_of(int length) {
  for (int code = 0; code < 16; code++) if (dlc_to_len[code] == length) return code;
  return -1;
}

static int packet(CANPacket_t *msg, unsigned int addr, unsigned int bus, const unsigned char *data, int length) {
  memset(msg, 0, sizeof(*msg));
  int code = code_of(length);
  if (code < 0) return 0;
  msg->addr = addr;
  msg->extended = addr >= 0x800U;
  msg->bus = bus;
  msg->data_len_code = code;
  memcpy(msg->data, data, length);
  return 1;
}

int judge_begin(int mode, int param) {
  timer_cnt = 0;
  int status = set_safety_hooks(mode, param);
  safety_mode_cnt = 2;  /* the relay has been switched for long */
  return status;
}

int judge_receive(unsigned int t, unsigned int addr, unsigned int bus, const unsigned char *data, int length) {
  CANPacket_t msg;
  timer_cnt = t;
  return packet(&msg, addr, bus, data, length) && safety_rx_hook(&msg);
}

int judge_send(unsigned int t, unsigned int addr, unsigned int bus, const unsigned char *data, int length) {
  CANPacket_t msg;
  timer_cnt = t;
  return packet(&msg, addr, bus, data, length) && safety_tx_hook(&msg);
}

void judge_tick(unsigned int t) {
  timer_cnt = t;
  safety_tick(&current_safety_config);
}

int judge_allowed(void) { return controls_allowed; }
int judge_relay(void) { return relay_malfunction; }
int judge_invalid(void) { return safety_rx_checks_invalid; }

/* What tx hooks of steering frames change, kept so that a frame can be judged without being sent. */
static struct {
  int torque, rt_torque, valid, invalid, angle;
  uint32_t ts_torque, ts_mismatch, ts_angle, rt_angle;
  bool allowed, relay;
} kept;

static void keep(void) {
  kept.torque = desired_torque_last; kept.rt_torque = rt_torque_last;
  kept.valid = valid_steer_req_count; kept.invalid = invalid_steer_req_count; kept.angle = desired_angle_last;
  kept.ts_torque = ts_torque_check_last; kept.ts_mismatch = ts_steer_req_mismatch_last;
  kept.ts_angle = ts_angle_check_last; kept.rt_angle = rt_angle_msgs;
  kept.allowed = controls_allowed; kept.relay = relay_malfunction;
}

static void restore(void) {
  desired_torque_last = kept.torque; rt_torque_last = kept.rt_torque;
  valid_steer_req_count = kept.valid; invalid_steer_req_count = kept.invalid; desired_angle_last = kept.angle;
  ts_torque_check_last = kept.ts_torque; ts_steer_req_mismatch_last = kept.ts_mismatch;
  ts_angle_check_last = kept.ts_angle; rt_angle_msgs = kept.rt_angle;
  controls_allowed = kept.allowed; relay_malfunction = kept.relay;
}

int judge_would_send(unsigned int t, unsigned int addr, unsigned int bus, const unsigned char *data, int length,
                     int allowed) {
  keep();
  controls_allowed = controls_allowed && allowed;
  int passes = judge_send(t, addr, bus, data, length);
  restore();
  return passes;
}
