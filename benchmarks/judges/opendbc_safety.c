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
void judge_allow(int yes) { controls_allowed = yes; }
