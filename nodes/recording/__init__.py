"""What a run leaves behind: written, read, recovered, accounted for, exported, played and plotted."""
