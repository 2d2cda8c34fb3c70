"""The live page: what a sensor feels, in the browser, while it feels it. The only room that knows viser.

    sensor thread:  Sensor ──read──▶ newest Moment                      as fast as the camera
    force threads:  WrenchSource ──read──▶ the last Wrenches            one for each source, if there is any
    page thread:    Moment ──draw──▶ View ──show──▶ browser             as fast as a person looks

loop.py       SensorLoop, the sensor thread: reads on and on, keeps the newest, never waits for whoever looks
studio.py     Studio, the page thread: takes the newest, draws it, says how it is; freezes and saves
view.py       View, all that the page draws of one reading; surface.py its 3D part, in mm
status.py     how the sensor is doing, in one sentence
page.py       where everything stands on the page; scene.py its 3D part, cards.py its figures, ruler.py its millimetres
wrench_loop.py, wrench_card.py, arrows.py   WrenchLoop, a force thread; its numbers and curves; its arrow over the skin
server.py     the web server, on the wanted port or not at all
history.py    the last seconds of indentation, and the rates
saved.py      readings as files; repeating.py recordings played again and again
"""
