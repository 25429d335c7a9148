"""Which of two layouts is better? The expected error of each, and the least possible one, before either is built."""

from fdcal.session.plan import PlanRequest, make_plan, read_layout

layouts = ("rectangle 4x4 0.5x0.5", "ball 16 0.3")
room = (5.0, 4.0, 2.6)

for text in layouts:
    request = PlanRequest(read_layout(text), room=room, reverberation_time=0.4, snr_db=30, takes=4)
    plan = make_plan(request)
    rms, low, high = (1e3 * value for value in (plan.forecast.rms, plan.forecast.low, plan.forecast.high))
    print(f"{text}: expected error {rms:.1f} mm ({low:.1f} to {high:.1f} mm in 8 of 10 recordings),"
          f" least error {1e3 * plan.bound.rms:.2f} mm, up to {request.f_max:.0f} Hz")  # fmt: skip
