# docker build --tag compasslib . && docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD/my_cruise:/cruise" compasslib run /cruise
FROM python:3.12-slim
COPY requirements/run.txt /src/requirements/run.txt
RUN pip install --no-cache-dir --require-hashes --requirement /src/requirements/run.txt
COPY . /src
RUN pip install --no-cache-dir --no-deps --no-build-isolation /src
ENV OMP_NUM_THREADS=1 HOME=/tmp
ENTRYPOINT ["compass"]
