"""Six controllers under delay: 0.15 s of steering delay and 0.12 s of lag, on 340 m of the 800 m course.

LQR, MPC and pure pursuit know the delay, Stanley does not; the learner has driven for 20 s.
"""

from steerkit import Experiment, learn
from steerkit.scenario.catalogue import make_controller
from steerkit.scenario.drive import drive
from steerkit.scenario import Scenario
from steerkit.metrics import of_log
from steerkit.plots.style import PALETTE, new_figure, style

scenario = Scenario(course="paper", steering={"delay": 0.15})
run = learn(Experiment(scenario=scenario, minutes=1 / 3, seed=1))
names = ("stanley", "stanley-textbook", "pure-pursuit", "lqr", "mpc")
logs = {name: drive(scenario, make_controller(name, scenario.design_model()), rounds=0.43) for name in names}
logs["learned"] = drive(scenario, run.policy, doe=run.experiment.setting.element(scenario.nominal), rounds=0.43)

figure, (above, below) = new_figure(rows=2, title="Six controllers, 0.15 s delay and 0.12 s lag", height=5.5)
below.remove()
with style():
    bars = figure.add_subplot(2, 1, 2)
for n, ((name, log), colour) in enumerate(zip(logs.items(), PALETTE)):
    found = of_log(log)
    above.plot(log["path.progress"], log["path.e"], color=colour, label=name, lw=1.0)
    bars.bar(name, found.rms_e, color=colour)
    bars.text(n, found.rms_e, f"{found.rms_e:.3f}", ha="center", va="bottom", fontsize=8)
    print(f"{name:17} RMS e {found.rms_e:.3f} m, max {found.max_e:.3f} m, wheel {found.rms_wheel_rate_deg:.0f} deg/s")
above.tick_params(labelbottom=True)
above.set(xlabel="distance [m]", ylabel="e [m], cut at 0.5", ylim=(-0.5, 0.5), xlim=(0.0, 342.0))
bars.set(ylabel="RMS e [m]", yscale="log", ylim=(0.001, 1.0))
above.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=6, frameon=False, fontsize=8)
figure.savefig("six_under_delay.png")
