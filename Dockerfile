# docker build -t outlast .
# docker run --rm outlast rollout teams_3 --worlds 1024 --policy scripted
# docker build -t outlast-train --build-arg EXTRAS=train,video .
# docker run --rm -v "$PWD/runs:/home/player/runs" outlast-train train teams_3 --preset fast --steps 5_000_000 --out runs/teams_3
FROM python:3.12-slim

ARG EXTRAS=video
COPY . /tmp/outlast
RUN pip install --no-cache-dir "/tmp/outlast[$EXTRAS]" && rm -rf /tmp/outlast

# Compiles the rules of the paper's games once, so that containers start at once, whatever their user, and if they are
# read-only. On another kind of processor than the builder's, they compile when they start.
ENV OUTLAST_CACHE_DIR=/opt/outlast
RUN for game in ffa_1 ffa_2 ffa_3 ffa_4 teams_1 teams_2 teams_3 teams_4; do outlast rollout $game --worlds 2 --steps 2 --policy random >/dev/null; done

RUN useradd --create-home player
USER player
WORKDIR /home/player

ENTRYPOINT ["outlast"]
CMD ["variants"]
