"""What flies in the second simulator: airframes, their equations of motion, motors and gusts."""
