"""What the driver of the USB board costs, over a virtual board that costs next to nothing."""
