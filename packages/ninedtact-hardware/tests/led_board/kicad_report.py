"""Run by the Python that KiCad is installed for: design-rule check and plot of a board file. Prints what it found as JSON."""

import json
import re
import sys
from pathlib import Path

import pcbnew

board_file, out = sys.argv[1], Path(sys.argv[2])
board = pcbnew.LoadBoard(board_file)
report = out / "drc.txt"
pcbnew.WriteDRCReport(board, str(report), pcbnew.EDA_UNITS_MILLIMETRES, True)
text = report.read_text()
plot = pcbnew.PLOT_CONTROLLER(board)
options = plot.GetPlotOptions()
options.SetOutputDirectory(str(out))
options.SetPlotFrameRef(False)
for layer, name in ((pcbnew.F_Cu, "F_Cu"), (pcbnew.B_Cu, "B_Cu"), (pcbnew.Edge_Cuts, "Edge_Cuts")):
    plot.SetLayer(layer)
    plot.OpenPlotfile(name, pcbnew.PLOT_FORMAT_GERBER, name)
    plot.PlotLayer()
plot.ClosePlot()
nets = {}
for pad in board.GetPads():
    if pad.GetNetname():
        nets.setdefault(pad.GetNetname(), []).append(f"{pad.GetParent().GetReference()}.{pad.GetNumber()}")
counts = [int(number) for number in re.findall(r"Found (\d+)", text)]
found = {"violations": counts[0], "unconnected": counts[1], "nets": nets, "report": text}
json.dump(found | {"thickness_mm": board.GetDesignSettings().GetBoardThickness() / 1e6}, sys.stdout)
