"""The names that `import cadenza` offers."""

from cadenza.agents.agent import Agent as Agent
from cadenza.agents.planner.config import PlannerConfig as PlannerConfig
from cadenza.agents.registry import make_agent as make_agent
from cadenza.episode import Episode as Episode
from cadenza.episode import load_episode as load_episode
from cadenza.errors import CadenzaError as CadenzaError
from cadenza.errors import CadenzaWarning as CadenzaWarning
from cadenza.fingers import Finger as Finger
from cadenza.learning.config import TrainingConfig as TrainingConfig
from cadenza.learning.learnt_policy import LearntPolicy as LearntPolicy
from cadenza.learning.policy_folder import load_policy as load_policy
from cadenza.music.arrangement import Arrangement as Arrangement
from cadenza.music.arrangement import load_song as load_song
from cadenza.music.libraries.library import open_library as open_library
from cadenza.music.libraries.songs import Library as Library
from cadenza.music.libraries.songs import Song as Song
from cadenza.music.libraries.songs import songs as songs
from cadenza.music.score import Note as Note
from cadenza.music.score import PedalEvent as PedalEvent
from cadenza.music.score import Score as Score
from cadenza.performing.performance import Performance as Performance
from cadenza.performing.performance import play as play
from cadenza.performing.planning import Plan as Plan
from cadenza.performing.planning import plan as plan
from cadenza.performing.training import TrainingResult as TrainingResult
from cadenza.performing.training import train as train
from cadenza.scene.config import SceneConfig as SceneConfig
from cadenza.tasks.config import DomainRandomization as DomainRandomization
from cadenza.tasks.config import TaskConfig as TaskConfig
from cadenza.tasks.env import PianoEnv as PianoEnv
from cadenza.tasks.env import PianoVectorEnv as PianoVectorEnv
from cadenza.tasks.reward import Outcome as Outcome
from cadenza.tasks.view import TaskSpec as TaskSpec
from cadenza.tasks.view import View as View

__version__: str
