"""The frames of a simulated production car: what its buses say, and what its steering makes of a command's frames.

Source of names and codes: commaai/opendbc 0.3.1 (MIT), `car/MAKER/carstate.py` and `safety/modes/MAKER.h`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from steerkit.car.production.platforms import Platform

Signals = dict[str, float]
SLOW = 10
"""What stands still is sent in every tenth step only."""


@dataclass(frozen=True, kw_only=True)
class Said:
    """What a production car says of itself; angles and rates + to the left, as everywhere."""

    angle_deg: float = 0.0
    """Of the steering wheel."""
    rate_deg: float = 0.0
    """Its rate, a second."""
    v: float = 0.0
    r: float = 0.0
    hand: bool = False
    """Is the human's hand at the wheel, strong enough to override?"""
    brake: bool = False
    gas: bool = False
    cruise: bool = True
    """Is its cruise control engaged? Steering is allowed only then."""
    door: bool = False
    belt: bool = True
    drive: bool = True
    """Is the lever at D?"""
    fault: bool = False
    """Has its steering a fault?"""
    motor: float = 0.0
    """The share of its largest torque that its motor gives."""


class Command(NamedTuple):
    """What a frame asks of the steering."""

    value: float
    """Steering-wheel angle [deg], curvature [1/m], or the share of the largest torque; + to the left."""
    active: bool


def _wheels(names: str, v: float) -> Signals:
    return dict.fromkeys(names.split(), v)


def _tesla(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    return {
        "DI_speed": {"DI_vehicleSpeed": kph},
        "ESP_B": {"ESP_vehicleSpeed": kph, "ESP_wheelSpeedsQF": 1, "ESP_vehicleStandstillSts": c.v == 0.0},
        "EPAS3S_sysStatus": {
            "EPAS3S_internalSAS": -c.angle_deg,
            "EPAS3S_handsOnLevel": 3 * c.hand,
            "EPAS3S_eacStatus": 0 if c.fault else 2,
            "EPAS3S_torsionBarTorque": -2.5 * c.hand,
        },
        "SCCM_steeringAngleSensor": {"SCCM_steeringAngleSpeed": -c.rate_deg},
        "DI_systemStatus": {"DI_gear": 4 if c.drive else 3, "DI_accelPedalPos": 20.0 * c.gas},
        "ESP_status": {"ESP_driverBrakeApply": 1 + c.brake},
        "DI_state": {"DI_cruiseState": 1 + c.cruise, "DI_speedUnits": 1},
        "UI_warning": {"buckleStatus": c.belt, "anyDoorOpen": c.door},
    }


def _ford(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    return {
        "SteeringPinion_Data": {"StePinComp_An_Est": c.angle_deg, "StePinCompAnEst_D_Qf": 3},
        "BrakeSysFeatures": {"Veh_V_ActlBrk": kph, "VehVActlBrk_D_Qf": 3},
        "EngVehicleSpThrottle2": {"Veh_V_ActlEng": kph, "VehVActlEng_D_Qf": 3},
        "Yaw_Data_FD1": {"VehYaw_W_Actl": c.r, "VehYawWActl_D_Qf": 3, "VehRolWActl_D_Qf": 3},
        "DesiredTorqBrk": {"VehStop_D_Stat": c.v == 0.0},
        "EngVehicleSpThrottle": {"ApedPos_Pc_ActlArb": 20.0 * c.gas},
        "EngBrakeData": {"BpedDrvAppl_D_Actl": 1 + c.brake, "CcStat_D_Actl": 5 if c.cruise else 3},
        "EPAS_INFO": {"SteeringColumnTorque": 2.5 * c.hand, "EPAS_Failure": c.fault},
        "Lane_Assist_Data3_FD1": {"LatCtlSte_D_Stat": 0 if c.fault else 2},
        "BodyInfo_3_FD1": {"DrStatDrv_B_Actl": c.door},
        "RCMStatusMessage2_FD1": {"FirstRowBuckleDriver": 1 if c.belt else 2},
        "BCM_Lamp_Stat_FD1": {"RvrseLghtOn_B_Stat": not c.drive},
        "PowertrainData_10": {"TrnRng_D_Rq": 3 if c.drive else 2},
        "Cluster_Info1_FD1": {"AccEnbl_B_RqDrv": 1},
    }


def _nissan(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    return {
        "STEER_ANGLE_SENSOR": {"STEER_ANGLE": c.angle_deg, "SET_ME_X07": 7},
        "WHEEL_SPEEDS_FRONT": _wheels("WHEEL_SPEED_FL WHEEL_SPEED_FR", kph),
        "WHEEL_SPEEDS_REAR": _wheels("WHEEL_SPEED_RL WHEEL_SPEED_RR", kph),
        "CRUISE_STATE": {"CRUISE_ENABLED": c.cruise},
        "PRO_PILOT": {"CRUISE_ON": 1},
        "CRUISE_THROTTLE": {"CRUISE_AVAILABLE": 1, "USER_BRAKE_PRESSED": c.brake, "GAS_PEDAL": 30 * c.gas},
        "GAS_PEDAL": {"GAS_PEDAL": 30 * c.gas},
        "DOORS_LIGHTS": {"USER_BRAKE_PRESSED": c.brake, "DOOR_OPEN_FL": c.door},
        "STEER_TORQUE_SENSOR": {"STEER_TORQUE_DRIVER": 2.5 * c.hand},
        "GEARBOX": {"GEAR_SHIFTER": 4 if c.drive else 3},
        "SEATBELT": {"SEATBELT_DRIVER_LATCHED": c.belt},
        "HUD": {"SEATBELT_DRIVER_LATCHED": c.belt},
        "CANCEL_MSG": {"CANCEL_SEATBELT": not c.belt},
    }


def _toyota(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v / p.params.wheelSpeedFactor
    lka = 9 if c.fault else 5
    return {
        "STEER_ANGLE_SENSOR": {"STEER_ANGLE": c.angle_deg, "STEER_RATE": c.rate_deg},
        "STEER_TORQUE_SENSOR": {
            "STEER_ANGLE": c.angle_deg,
            "STEER_TORQUE_DRIVER": 200.0 * c.hand,
            "STEER_TORQUE_EPS": round(p.full * c.motor) / p.motor_scale,
        },
        "EPS_STATUS": {"LKA_STATE": lka, "LTA_STATE": lka},
        "WHEEL_SPEEDS": _wheels("WHEEL_SPEED_FL WHEEL_SPEED_FR WHEEL_SPEED_RL WHEEL_SPEED_RR", kph),
        "PCM_CRUISE": {"CRUISE_ACTIVE": c.cruise, "GAS_RELEASED": not c.gas, "CRUISE_STATE": 8 * c.cruise},
        "PCM_CRUISE_2": {"MAIN_ON": 1, "LOW_SPEED_LOCKOUT": 1},
        "DSU_CRUISE": {"MAIN_ON": 1},
        "BRAKE_MODULE": {"BRAKE_PRESSED": c.brake},
        "BODY_CONTROL_STATE": {"DOOR_OPEN_FL": c.door, "SEATBELT_DRIVER_UNLATCHED": not c.belt},
        "GEAR_PACKET": {"GEAR": 0 if c.drive else 8},
    }


def _honda(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    switches: Signals = {"MAIN_ON": 1, "DRIVERS_DOOR_OPEN": c.door, "REVERSE_LIGHT": not c.drive}
    return {
        "STEERING_SENSORS": {"STEER_ANGLE": c.angle_deg, "STEER_ANGLE_RATE": c.rate_deg},
        "WHEEL_SPEEDS": _wheels("WHEEL_SPEED_FL WHEEL_SPEED_FR WHEEL_SPEED_RL WHEEL_SPEED_RR", kph),
        "ENGINE_DATA": {"XMISSION_SPEED": kph},
        "CAR_SPEED": {"ROUGH_CAR_SPEED_2": kph},
        "POWERTRAIN_DATA": {"ACC_STATUS": c.cruise, "PEDAL_GAS": 30 * c.gas, "BRAKE_PRESSED": c.brake},
        "BRAKE_MODULE": {"BRAKE_PRESSED": c.brake},
        "SCM_FEEDBACK": switches,
        "SCM_BUTTONS": switches,
        "DOORS_STATUS": {"DOOR_OPEN_FL": c.door},
        "SEATBELT_STATUS": {"SEATBELT_DRIVER_LATCHED": c.belt},
        "STEER_STATUS": {"STEER_STATUS": 5.0 * c.fault, "STEER_TORQUE_SENSOR": 2500.0 * c.hand},
        "GEARBOX_AUTO": {"GEAR_SHIFTER": p.code_of("GEARBOX_AUTO", "GEAR_SHIFTER", "D" if c.drive else "N")},
        "GEARBOX_CVT": {"GEAR_SHIFTER": p.code_of("GEARBOX_CVT", "GEAR_SHIFTER", "D" if c.drive else "N")},
    }


def _hyundai(c: Said, p: Platform) -> dict[str, Signals]:
    kph, gear, rate = 3.6 * c.v, "D" if c.drive else "N", abs(c.rate_deg)
    if p.can_fd:
        wheels = _wheels("WHL_SpdFLVal WHL_SpdFRVal WHL_SpdRLVal WHL_SpdRRVal", kph)
        return {
            "STEERING_SENSORS": {"STEERING_ANGLE": c.angle_deg, "STEERING_RATE": rate},
            "MDPS": {"MDPS_StrTqSnsrVal": 500 * c.hand, "MDPS_LkaFailSta": c.fault},
            "WHEEL_SPEEDS": wheels,
            "TCS": {"DriverBraking": c.brake},
            "ACCELERATOR": {"ACCELERATOR_PEDAL": 30 * c.gas, "GEAR": p.code_of("ACCELERATOR", "GEAR", gear)},
            "ACCELERATOR_ALT": {"ACCELERATOR_PEDAL": 30 * c.gas},
            "ACCELERATOR_BRAKE_ALT": {"ACCELERATOR_PEDAL_PRESSED": c.gas},
            "DOORS_SEATBELTS": {"DRIVER_DOOR": c.door, "DRIVER_SEATBELT": c.belt},
            "SCC_CONTROL": {"ACCMode": c.cruise},
            "CRUISE_BUTTONS": {"CRUISE_BUTTONS": 2 * (not c.cruise)},
            "CRUISE_BUTTONS_ALT": {"CRUISE_BUTTONS": 2 * (not c.cruise)},
            **{name: {"GEAR": p.code_of(name, "GEAR", gear)} for name in ("GEAR_SHIFTER", "GEAR_ALT", "GEAR_ALT_2")},
        }
    return {
        "SAS11": {"SAS_Angle": c.angle_deg, "SAS_Speed": rate},
        "MDPS12": {"CR_Mdps_StrColTq": 300 * c.hand, "CF_Mdps_ToiFlt": c.fault},
        "WHL_SPD11": _wheels("WHL_SPD_FL WHL_SPD_FR WHL_SPD_RL WHL_SPD_RR", kph),
        "TCS13": {"DriverOverride": 2 * c.brake},
        "EMS16": {"CF_Ems_AclAct": c.gas},
        "E_EMS11": {"CR_Vcu_AccPedDep_Pos": 30 * c.gas, "Accel_Pedal_Pos": 30 * c.gas},
        "FCEV_ACCELERATOR": {"ACCELERATOR_PEDAL": 30 * c.gas},
        "CGW1": {"CF_Gway_DrvDrSw": c.door, "CF_Gway_DrvSeatBeltSw": c.belt},
        "SCC11": {"MainMode_ACC": 1},
        "SCC12": {"ACCMode": c.cruise},
        "CLU11": {"CF_Clu_CruiseSwState": 2 * (not c.cruise)},
        "LVR12": {"CF_Lvr_Gear": 5 if c.drive else 6},
        "ELECT_GEAR": {"Elect_Gear_Shifter": 5 if c.drive else 6},
        "CLU15": {"CF_Clu_Gear": 8 if c.drive else 4},
        "TCU12": {"CUR_GR": 1 if c.drive else 14},
        "EMS20": {"HYDROGEN_GEAR_SHIFTER": p.code_of("EMS20", "HYDROGEN_GEAR_SHIFTER", gear)},
    }


def _volkswagen(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    left = c.angle_deg >= 0.0
    return {
        "LWI_01": {"LWI_Lenkradwinkel": abs(c.angle_deg), "LWI_VZ_Lenkradwinkel": not left},
        "LH_EPS_03": {"EPS_HCA_Status": 4 if c.fault else 3, "EPS_Lenkmoment": 200 * c.hand},
        "ESP_19": _wheels("ESP_VL_Radgeschw_02 ESP_VR_Radgeschw_02 ESP_HL_Radgeschw_02 ESP_HR_Radgeschw_02", kph),
        "ESP_05": {"ESP_Fahrer_bremst": c.brake},
        "Motor_14": {"MO_Fahrer_bremst": c.brake},
        "TSK_06": {"TSK_Status": 2 + c.cruise},
        "Motor_20": {"MO_Fahrpedalrohwert_01": 20.0 * c.gas},
        "Gateway_72": {"ZV_FT_offen": c.door, "BCM1_Rueckfahrlicht_Schalter": not c.drive},
        "Airbag_02": {"AB_Gurtschloss_FA": 3 if c.belt else 2},
        "ACC_02": {"ACC_Gesetzte_Zeitluecke": 3},
        # PQ
        "Lenkhilfe_3": {"LH3_BLW": abs(c.angle_deg), "LH3_BLWSign": not left, "LH3_LM": 200 * c.hand},
        "Lenkhilfe_2": {"LH2_Sta_HCA": 4 if c.fault else 7},
        "Bremse_1": {"BR1_Rad_kmh": kph},
        "Motor_2": {"MO2_BLS": c.brake, "MO2_Sta_GRA": c.cruise},
        "Motor_3": {"MO3_Pedalwert": 20.0 * c.gas},
        "Motor_5": {"MO5_GRA_Hauptsch": 1},
        "Airbag_1": {"Gurtschalter_Fahrer": c.belt},
        "Gate_Komf_1": {"GK1_Fa_Tuerkont": c.door, "GK1_Rueckfahr": not c.drive},
    }


def _subaru(c: Said, p: Platform) -> dict[str, Signals]:
    return {
        "Steering_Torque": {
            "Steering_Angle": c.angle_deg,
            "Steer_Torque_Sensor": 120 * c.hand,
            "Steer_Error_1": c.fault,
        },
        "Steering_2": {"Steering_Angle": c.angle_deg},
        "Wheel_Speeds": _wheels("FL FR RL RR", 3.6 * c.v),
        "Throttle": {"Throttle_Pedal": 30 * c.gas},
        "Throttle_Hybrid": {"Throttle_Pedal": 30 * c.gas},
        "Brake_Status": {"Brake": c.brake},
        "Brake_Pedal": {"Brake_Pedal": 20 * c.brake},
        "CruiseControl": {"Cruise_On": 1, "Cruise_Activated": c.cruise},
        "ES_Brake": {"Cruise_Activated": c.cruise},
        "ES_DashStatus": {"Cruise_On": 1},
        "Transmission": {"Gear": p.code_of("Transmission", "Gear", "D" if c.drive else "N")},
        "Dashlights": {"SEATBELT_FL": not c.belt},
        "BodyInfo": {"DOOR_OPEN_FL": c.door},
    }


def _chrysler(c: Said, p: Platform) -> dict[str, Signals]:
    torque = {"COLUMN_TORQUE": 200 * c.hand, "EPS_TORQUE_MOTOR": round(p.full * c.motor)}
    return {
        "STEERING": {"STEERING_ANGLE": c.angle_deg, "STEERING_ANGLE_HP": 0.0, "STEERING_RATE": c.rate_deg},
        "EPS_2": {**torque, "LKAS_STATE": 4 if c.fault else 0},
        "EPS_3": {"DASM_FAULT": c.fault},
        "SPEED_1": _wheels("SPEED_LEFT SPEED_RIGHT", c.v),
        "ESP_8": {"Vehicle_Speed": 3.6 * c.v},
        "ESP_1": {"Brake_Pedal_State": c.brake},
        "ECM_5": {"Accelerator_Position": 20.0 * c.gas},
        "DAS_3": {"ACC_AVAILABLE": 1, "ACC_ACTIVE": c.cruise},
        "GEAR": {"PRNDL": 4 if c.drive else 3},
        "Transmission_Status": {"Gear_State": 4 if c.drive else 2},
        "BCM_1": {"DOOR_OPEN_FL": c.door},
        "ORC_1": {"SEATBELT_DRIVER_UNLATCHED": not c.belt},
        "DAS_6": {"CAR_MODEL": 1},
    }


def _mazda(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    return {
        "STEER": {"STEER_ANGLE": c.angle_deg},
        "STEER_RATE": {"STEER_ANGLE_RATE": c.rate_deg},
        "STEER_TORQUE": {"STEER_TORQUE_SENSOR": 40 * c.hand},
        "WHEEL_SPEEDS": _wheels("FL FR RL RR", kph),
        "ENGINE_DATA": {"SPEED": kph, "PEDAL_GAS": 30 * c.gas},
        "PEDALS": {"BRAKE_ON": c.brake},
        "CRZ_CTRL": {"CRZ_AVAILABLE": 1, "CRZ_ACTIVE": c.cruise},
        "GEAR": {"GEAR": 4 if c.drive else 3},
        "SEATBELT": {"DRIVER_SEATBELT": c.belt},
        "DOORS": {"FL": c.door},
        "CAM_LANEINFO": {"LANE_LINES": 2},
        "CAM_LKAS": {"ERR_BIT_1": c.fault},
    }


def _gm(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    return {
        "PSCMSteeringAngle": {"SteeringWheelAngle": c.angle_deg, "SteeringWheelRate": c.rate_deg},
        "PSCMStatus": {"LKADriverAppldTrq": 3.0 * c.hand, "LKATorqueDeliveredStatus": 3 if c.fault else 1},
        "EBCMWheelSpdFront": _wheels("FLWheelSpd FRWheelSpd", kph),
        "EBCMWheelSpdRear": {**_wheels("RLWheelSpd RRWheelSpd", kph), "RLWheelDir": 1, "RRWheelDir": 1},
        "ECMPRDNL2": {"PRNDL2": 4 if c.drive else 3},
        "ECMAcceleratorPos": {"BrakePedalPos": 30 * c.brake},
        "ECMEngineStatus": {"CruiseMainOn": 1, "BrakePressed": c.brake},
        "AcceleratorPedal2": {"AcceleratorPedal2": 30 * c.gas, "CruiseState": c.cruise},
        "BCMDoorBeltStatus": {"FrontLeftDoor": c.door, "LeftSeatBelt": c.belt},
        "ESPStatus": {"TractionControlOn": 1},
        "ASCMActiveCruiseControlStatus": {"ACCCruiseState": 2},
        "ASCMSteeringButton": {"ACCButtons": 1},
    }


def _rivian(c: Said, p: Platform) -> dict[str, Signals]:
    kph = 3.6 * c.v
    drive = 4 if c.drive else 3
    closed = dict.fromkeys(("RearDriverDoor", "FrontPassengerDoor", "RearPassengerDoor"), 2.0)
    return {
        "EPAS_AdasStatus": {
            "EPAS_InternalSas": c.angle_deg,
            "EPAS_SteeringAngleSpeed": c.rate_deg,
            "EPAS_EacErrorCode": c.fault,
        },
        "EPAS_SystemStatus": {"EPAS_TorsionBarTorque": 2.5 * c.hand},
        "ESP_Status": {"ESP_Vehicle_Speed": kph, "ESP_Vehicle_Speed_Q": 1},
        "VDM_PropStatus": {
            "VDM_VehicleSpeed": kph,
            "VDM_VehicleSpeedQ": 1,
            "VDM_AcceleratorPedalPosition": 20.0 * c.gas,
            "VDM_Prndl_Status": drive,
        },
        "iBESP2": {"iBESP2_BrakePedalApplied": c.brake},
        "ACM_Status": {"ACM_FeatureStatus": c.cruise},
        "VDM_AdasSts": {"VDM_AdasFaultStatus": 1},
        "IndicatorLights": {"DriverDoor": 1 if c.door else 2, **closed},
        "RCM_Status": {"RCM_Status_IND_WARN_BELT_DRIVER": not c.belt},
    }


SAYS: dict[str, Callable[[Said, Platform], dict[str, Signals]]] = {
    "chrysler": _chrysler,
    "ford": _ford,
    "gm": _gm,
    "honda": _honda,
    "hyundai": _hyundai,
    "mazda": _mazda,
    "nissan": _nissan,
    "rivian": _rivian,
    "subaru": _subaru,
    "tesla": _tesla,
    "toyota": _toyota,
    "volkswagen": _volkswagen,
}
"""By maker: the values of messages that say something; those without a value are sent as zeros."""
ASKS: dict[str, tuple[tuple[str, str, str, float], ...]] = {
    "chrysler": (("LKAS_COMMAND", "STEERING_TORQUE", "LKAS_CONTROL_BIT", 1.0),),
    "ford": (
        ("LateralMotionControl", "LatCtlCurv_No_Actl", "LatCtl_D_Rq", 1.0),
        ("LateralMotionControl2", "LatCtlCurv_No_Actl", "LatCtl_D2_Rq", 1.0),
    ),
    "gm": (("ASCMLKASteeringCmd", "LKASteeringCmd", "LKASteeringCmdActive", 1.0),),
    "honda": (("STEERING_CONTROL", "STEER_TORQUE", "STEER_TORQUE_REQUEST", -1.0),),
    "hyundai": (
        ("LKAS11", "CR_Lkas_StrToqReq", "CF_Lkas_ActToi", 1.0),
        ("LFA", "StrTqReqVal", "ActToiSta", 1.0),
        ("LKAS", "StrTqReqVal", "ActToiSta", 1.0),
        ("LKAS_ALT", "StrTqReqVal", "ActToiSta", 1.0),
    ),
    "mazda": (("CAM_LKAS", "LKAS_REQUEST", "", 1.0),),
    "nissan": (("LKAS", "DESIRED_ANGLE", "LKA_ACTIVE", 1.0),),
    "rivian": (("ACM_lkaHbaCmd", "ACM_lkaStrToqReq", "ACM_lkaActToi", 1.0),),
    "subaru": (("ES_LKAS", "LKAS_Output", "LKAS_Request", 1.0),),
    "tesla": (("DAS_steeringControl", "DAS_steeringAngleRequest", "DAS_steeringControlType", -1.0),),
    "toyota": (
        ("STEERING_LTA", "STEER_ANGLE_CMD", "STEER_REQUEST", 1.0),
        ("STEERING_LKA", "STEER_TORQUE_CMD", "STEER_REQUEST", 1.0),
    ),
    "volkswagen": (("HCA_01", "HCA_01_LM_Offset", "HCA_01_Sendestatus", 1.0), ("HCA_1", "LM_Offset", "", 1.0)),
}
"""By maker: the messages that steer: name, signal of the value, signal of the request, sign; Toyota's first one
takes an angle, and only cars that are steered by one heed it."""
MORE = {
    "ford": ("EngVehicleSpThrottle2",),
    "hyundai": ("EMS16",),
    "nissan": ("BRAKE_PEDAL",),
    "volkswagen": ("Motor_14", "GRA_ACC_01"),
}
"""By maker: messages that only the safety code reads, on the first bus."""
SHORTER = {"BRAKE_PEDAL": 4}
"""Messages that are shorter on the bus than in their DBC, in bytes."""


class CarFrames:
    """The frames that a production car sends, step by step, and what its steering reads of those sent to it.

    platform: which. It counts its frames, so that counters go on; what a car says otherwise is in `Said`.
    """

    def __init__(self, platform: Platform):
        from opendbc.can import CANPacker

        self.platform = platform
        interface = platform.interface()
        self._messages: list[tuple[Any, Any, int, str]] = []
        says = set(self._says(Said()))
        for parser in interface.can_parsers.values():
            if parser is None or parser.bus >= 128:
                continue  # what the computer itself sent
            packer = CANPacker(parser.dbc_name)
            names = [state.name for state in parser.message_states.values() if not state.ignore_alive]
            first = parser.bus == min(p.bus for p in interface.can_parsers.values() if p and p.message_states)
            names += [name for name in MORE.get(platform.maker, ()) if first and name not in names]
            for name in names:
                if message := parser.dbc.name_to_msg.get(name):
                    self._messages.append((packer, message, parser.bus, name if name in says else ""))
        self._step = 0
        self._asks = {}
        dbc = next(iter(interface.can_parsers.values())).dbc
        for name, value, active, sign in ASKS[platform.maker]:
            heeded = name != ("STEERING_LKA" if platform.steered_by == "angle" else "STEERING_LTA")
            if heeded and (message := dbc.name_to_msg.get(name)):
                self._asks[message.address] = (message, value, active, sign)

    def _says(self, said: Said) -> dict[str, Signals]:
        return SAYS[self.platform.maker](said, self.platform)

    def send(self, said: Said) -> list[tuple[int, bytes, int]]:
        """The frames (id, data, bus) of one step of 10 ms."""
        values, frames, slow = self._says(said), [], self._step % SLOW == 0
        for packer, message, bus, name in self._messages:
            if name or slow:
                known = {k: float(v) for k, v in values.get(name, {}).items() if k in message.sigs}
                data = bytes(packer.pack(message.address, known))[: SHORTER.get(message.name)]
                frames.append((message.address, self._protected(message, data), bus))
        self._step += 1
        return frames

    def _protected(self, message: Any, data: bytes) -> bytes:
        """With the counters and check sums that the library's packer does not know."""
        protect = PROTECTS.get(self.platform.maker)
        return data if protect is None else bytes(protect(message.name, bytearray(data), self._step))

    def command(self, frame_id: int, data: bytes, v: float) -> Command | None:
        """What a frame from the computer asks of the steering at v [m/s]; None for one that does not steer."""
        from opendbc.can.parser import get_raw_value

        if frame_id not in self._asks:
            return None
        message, value, active, sign = self._asks[frame_id]

        def read(name: str) -> float:
            signal = message.sigs[name]
            raw = get_raw_value(data, signal)
            raw -= (1 << signal.size) if signal.is_signed and raw >> (signal.size - 1) else 0
            return float(raw * signal.factor + signal.offset)

        asked = sign * read(value)
        if self.platform.maker == "volkswagen":
            asked *= -1.0 if read("HCA_01_LM_OffSign" if "HCA_01_LM_OffSign" in message.sigs else "LM_OffSign") else 1.0
        on = read(active) != 0.0 if active else asked != 0.0
        return Command(asked / self.platform.full_at(v), on)

    def altered(self, frame_id: int, data: bytes, *, by: float = 0.0, active: bool | None = None) -> bytes:
        """A frame that steers, with another value (by so much, in units of its `Command`) or request; for tests.

        Its check sum stays as it was. Raises KeyError for a frame that does not steer.
        """
        from opendbc.can.packer import set_value
        from opendbc.can.parser import get_raw_value

        message, value, request, sign = self._asks[frame_id]
        changed, signal = bytearray(data), message.sigs[value]
        if by:
            full = self.platform.full if self.platform.steered_by == "torque" else 1.0
            command = self.command(frame_id, data, 0.0)
            assert command is not None
            wanted = sign * (command.value * self.platform.full_at(0.0) + by * full)
            if self.platform.maker == "volkswagen":
                side = message.sigs["HCA_01_LM_OffSign" if "HCA_01_LM_OffSign" in message.sigs else "LM_OffSign"]
                set_value(changed, side, int(wanted < 0.0))
                wanted = abs(wanted)
            code = round((wanted - signal.offset) / signal.factor)
            low, high = (
                (-(1 << signal.size - 1), (1 << signal.size - 1) - 1)
                if signal.is_signed
                else (0, (1 << signal.size) - 1)
            )
            set_value(changed, signal, max(low, min(high, code)))
        if active is not None and request:
            old = get_raw_value(data, message.sigs[request])
            set_value(changed, message.sigs[request], (old or 1) if active else 0)
        return bytes(changed)


def _protect_ford(name: str, data: bytearray, count: int) -> bytearray:
    """Source: opendbc `safety/modes/ford.h`, ford_compute_checksum: 0xFF less the sum of what it protects."""
    if name == "BrakeSysFeatures":
        data[2] = data[2] & 0xC3 | (count & 0xF) << 2
        data[3] = 0xFF - (data[0] + data[1] + (data[2] >> 6) + (data[2] >> 2 & 0xF)) & 0xFF
    elif name == "Yaw_Data_FD1":
        data[5] = count & 0xFF
        data[4] = 0xFF - (sum(data[:4]) + data[5] + (data[6] >> 6) + (data[6] >> 4 & 3)) & 0xFF
    return data


def _protect_hyundai(name: str, data: bytearray, count: int) -> bytearray:
    """Source: opendbc `safety/modes/hyundai.h`, hyundai_get_counter, hyundai_compute_checksum."""
    if name == "WHL_SPD11":
        for byte, code in ((1, count), (3, count >> 2), (5, 0), (7, 0)):
            data[byte] = data[byte] & 0x3F | (code & 3) << 6
        bits = sum(byte.bit_count() for byte in data)
        bits -= sum((data[byte] >> 6).bit_count() for byte in (1, 3))
        code = (bits ^ 9) & 15
        data[5], data[7] = data[5] | (code & 3) << 6, data[7] | (code >> 2) << 6
    elif name == "TCS13":
        data[1], data[6] = data[1] & 0x1F | (count & 7) << 5, data[6] & 0xF0
        data[6] |= -_nibbles(data[:7]) & 15
    elif name == "EMS16":
        data[7] = data[7] & 0xC0 | (count & 3) << 4
        data[7] |= -_nibbles(data) & 15
    elif name == "SCC12":
        data[7] = count & 15
        data[7] |= (-_nibbles(data) & 15) << 4
    elif name == "CLU11":
        data[3] = data[3] & 0x0F | (count & 15) << 4
    return data


def _protect_rivian(name: str, data: bytearray, count: int) -> bytearray:
    """Source: opendbc `safety/modes/rivian.h`: counters from 0 to 14, CRC-8 with polynomial 0x1D."""
    ends = {"ESP_Status": 0xB1, "VDM_PropStatus": 0x9A}
    if name in ends:
        data[1] = data[1] & 0xF0 | count % 15
        crc = 0
        for byte in data[1:]:
            crc ^= byte
            for _ in range(8):
                crc = (crc << 1 ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
        data[0] = crc ^ ends[name]
    return data


PROTECTS = {"ford": _protect_ford, "hyundai": _protect_hyundai, "rivian": _protect_rivian}


def _nibbles(data: bytearray) -> int:
    return sum((byte & 15) + (byte >> 4) for byte in data)
