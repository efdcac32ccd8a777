from .envs.adapters.gymnasium_agents import make_agents as make_agents
from .envs.adapters.pettingzoo import aec_env as aec_env
from .envs.adapters.pettingzoo import parallel_env as parallel_env
from .envs.adapters.puffer import make_puffer as make_puffer
from .envs.adapters.rllib import SurvivalMultiAgentEnv as SurvivalMultiAgentEnv
from .envs.adapters.sb3 import make_sb3 as make_sb3
from .envs.adapters.torchrl import make_torchrl as make_torchrl
from .envs.core.observations import scaled as scaled
