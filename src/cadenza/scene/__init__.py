"""The figures of the piano and the hands, and the builders that turn them into a MuJoCo scene."""
