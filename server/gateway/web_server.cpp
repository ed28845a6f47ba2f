// SPDX-License-Identifier: GPL-3.0-or-later
// The one file that sees Asio, Beast and OpenSSL: they cost 20 s of compiling.
#include "gateway/web_server.hpp"

#include <array>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/experimental/awaitable_operators.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/multiple_exceptions.hpp>
#include <boost/asio/ssl.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <exception>
#include <filesystem>
#include <list>
#include <optional>
#include <utility>

#include "suture/error.hpp"

namespace sutured::gateway {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using asio::ip::tcp;
using boost::system::error_code;
using Clock = std::chrono::steady_clock;

constexpr auto kAwait = asio::as_tuple(asio::use_awaitable);
constexpr std::size_t kHeadersMax = 8U << 10U;
constexpr std::size_t kMessageMax = 64U << 10U, kPiece = 4096;
// What the kernel holds for a client that does not read; a frame of a mesh fits.
constexpr int kSendBuffer = 256 << 10;
constexpr std::chrono::milliseconds kGoodbye(300);
constexpr std::chrono::milliseconds kOutOfFiles(100);

using HttpRequest = http::request<http::empty_body>;
using HttpResponse = http::response<http::string_body>;

std::string text(beast::string_view view) { return {view.data(), view.size()}; }

Request request_of(const HttpRequest& message) {
  const auto header = [&](http::field field) { return text(message[field]); };
  Request request;
  const std::string target = text(message.target());
  const std::size_t mark = target.find('?');
  request.path = target.substr(0, mark);
  if (mark != std::string::npos) request.query = target.substr(mark + 1);
  request.host = header(http::field::host);
  request.origin = header(http::field::origin);
  request.authorization = header(http::field::authorization);
  request.subprotocols = header(http::field::sec_websocket_protocol);
  request.if_none_match = header(http::field::if_none_match);
  request.accepts_gzip = header(http::field::accept_encoding).find("gzip") != std::string::npos;
  return request;
}

HttpResponse response_of(const Reply& reply, const HttpRequest& request) {
  HttpResponse response{static_cast<http::status>(reply.status), request.version()};
  response.set(http::field::server, "sutured");
  response.set(http::field::content_type, reply.content_type);
  response.set("X-Content-Type-Options", "nosniff");
  response.set("Referrer-Policy", "no-referrer");
  response.set("X-Frame-Options", "DENY");
  response.set("Content-Security-Policy",
               "default-src 'self'; connect-src 'self' ws: wss:; img-src 'self' data: blob:; "
               "style-src 'self' 'unsafe-inline'; frame-ancestors 'none'");
  response.set(http::field::cache_control,
               reply.immutable ? "public, max-age=31536000, immutable" : "no-cache");
  response.set(http::field::vary, "Accept-Encoding");
  if (reply.gzip) response.set(http::field::content_encoding, "gzip");
  if (!reply.etag.empty()) response.set(http::field::etag, reply.etag);
  if (reply.status == 405) response.set(http::field::allow, "GET, HEAD");
  if (reply.status == 401) response.set(http::field::www_authenticate, "Bearer");
  response.keep_alive(request.keep_alive());
  const std::size_t size = reply.body ? reply.body->size() : 0;
  if (request.method() != http::verb::head && reply.body) response.body() = *reply.body;
  response.content_length(size);
  return response;
}

// A key that others may read is no secret.
void refuse_open_key(const std::string& file) {
  using std::filesystem::perms;
  std::error_code error;
  const perms mode = std::filesystem::status(file, error).permissions();
  if (!error && (mode & perms::others_all) != perms::none)
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "the key " + file + " is open to every user of this machine",
                        "chmod o= " + file);
}

// Returns TLS of that certificate, or throws an Error that says what is wrong with it.
asio::ssl::context tls_of(const std::string& certificate, const std::string& key) {
  asio::ssl::context tls(asio::ssl::context::tls_server);
  error_code error;
  tls.set_options(asio::ssl::context::no_tlsv1 | asio::ssl::context::no_tlsv1_1, error);
  if (!error) tls.use_certificate_chain_file(certificate, error);
  if (error)
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "cannot read the certificate " + certificate + ": " + error.message(),
                        "give a PEM file with the certificate and its chain");
  refuse_open_key(key);
  tls.use_private_key_file(key, asio::ssl::context::pem, error);
  if (error)
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "cannot use the key " + key + ": " + error.message(),
                        "give the PEM file of the certificate's own private key");
  return tls;
}

// Who speaks plain HTTP to a port of TLS.
bool is_plain_http(const error_code& error) {
  return error.category() == asio::error::get_ssl_category() &&
         ERR_GET_REASON(static_cast<unsigned long>(error.value())) == SSL_R_HTTP_REQUEST;
}

std::string text_of(const std::exception_ptr& fault) {
  try {
    std::rethrow_exception(fault);
  } catch (const std::exception& error) {
    return error.what();
  } catch (...) {
    return "not an exception of the standard library";
  }
}

// The listening socket, or an Error that says why there is none.
tcp::acceptor listening(asio::io_context& io, const WebServer::Options& options) {
  const std::string where = options.address + " port " + std::to_string(options.port);
  error_code error;
  const auto address = asio::ip::make_address(options.address, error);
  if (error)
    throw suture::Error(suture::ErrorCode::kBadInput,
                        "\"" + options.address + "\" is not a numeric address",
                        "say --http 127.0.0.1:8080, or [::1]:8080, or off");
  tcp::acceptor acceptor(io);
  const tcp::endpoint endpoint(address, options.port);
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
  if (error)
    throw suture::Error(suture::ErrorCode::kNetwork,
                        "cannot listen on " + where + ": " + error.message(),
                        "choose another address or port with --http, or --http off");
  return acceptor;
}

}  // namespace

Reply plain_reply(unsigned status, std::string line) {
  Reply reply;
  reply.status = status;
  line += '\n';
  reply.body = std::make_shared<const std::string>(std::move(line));
  return reply;
}

struct WebServer::State {
  State(const Options& options_in, Handlers handlers_in)
      : options(options_in), handlers(std::move(handlers_in)) {
    io.emplace(1);
    if (!options.certificate.empty()) tls.emplace(tls_of(options.certificate, options.key));
    acceptor.emplace(listening(*io, options));
    port = acceptor->local_endpoint().port();
  }

  // Coroutines that never ran refer to all this: they go with `io`, before the rest.
  ~State() {
    acceptor.reset();
    io.reset();
  }

  void spawn(asio::awaitable<void> task) {
    asio::co_spawn(*io, std::move(task), [this](const std::exception_ptr& fault) {
      if (fault) note(fault);
    });
  }

  // Out of memory, or a fault of ours: what it came from is gone, the rest stays. People are
  // told, but not as often as strangers may like.
  void note(const std::exception_ptr& fault) {
    ++counters.faults;
    const auto now = Clock::now();
    if (told && now - *told < kFaultSilence) return;
    told = now;
    handlers.fault("a web connection or task ended by a fault (" + std::to_string(counters.faults) +
                   " so far): " + text_of(fault));
  }

  // Runs `task`, and survives it.
  template <class Task>
  void guard(Task&& task) {
    try {
      task();
    } catch (...) {
      note(std::current_exception());
    }
  }

  asio::awaitable<void> accept() {
    asio::steady_timer pause(*io);
    while (!stopping) {
      auto [error, socket] = co_await acceptor->async_accept(kAwait);
      if (stopping) co_return;
      if (error) {  // no file descriptor left, most likely: those that end give theirs back
        pause.expires_after(kOutOfFiles);
        co_await pause.async_wait(kAwait);
        continue;
      }
      if (counters.connections_open >= options.connections_max) {
        ++counters.connections_refused;
        continue;
      }
      guard([this, &accepted = socket] {
        error_code ignored;
        accepted.set_option(tcp::no_delay(true), ignored);
        accepted.set_option(asio::socket_base::send_buffer_size(kSendBuffer), ignored);
        ++counters.connections;
        spawn(connection(std::move(accepted)));
      });
    }
  }

  struct Open {
    explicit Open(WebCounters& counters_in) : counters(counters_in) { ++counters.connections_open; }
    ~Open() { --counters.connections_open; }
    Open(const Open&) = delete;
    Open& operator=(const Open&) = delete;
    WebCounters& counters;
  };

  // What ends a wait of a coroutine when the server ends.
  class Ender {
   public:
    Ender(State& state, std::function<void()> end)
        : state_(state), place_(state.enders.insert(state.enders.end(), std::move(end))) {}
    ~Ender() { state_.enders.erase(place_); }
    Ender(const Ender&) = delete;
    Ender& operator=(const Ender&) = delete;

   private:
    State& state_;
    std::list<std::function<void()>>::iterator place_;
  };

  // A client that is spoken to: it can be woken, until this ends, by a fault too.
  class Presence {
   public:
    Presence(State& state, WebClient& client, asio::steady_timer& bell)
        : state_(state),
          client_(client),
          place_(state.clients.insert(state.clients.end(), &client)) {
      client_.wake = [&bell] { bell.cancel(); };
    }
    ~Presence() {
      client_.wake = [] {};
      state_.clients.erase(place_);
    }
    Presence(const Presence&) = delete;
    Presence& operator=(const Presence&) = delete;

   private:
    State& state_;
    WebClient& client_;
    std::list<WebClient*>::iterator place_;
  };

  asio::awaitable<void> connection(tcp::socket socket) {
    const Open open(counters);
    if (!tls) {
      co_await serve(beast::tcp_stream(std::move(socket)));
      co_return;
    }
    beast::ssl_stream<beast::tcp_stream> stream(std::move(socket), *tls);
    std::optional<Ender> ender(std::in_place, *this,
                               [&stream] { beast::get_lowest_layer(stream).close(); });
    beast::get_lowest_layer(stream).expires_after(options.request_patience);
    auto [error] = co_await stream.async_handshake(asio::ssl::stream_base::server, kAwait);
    if (!error) {
      ender.reset();  // a TLS stream that was moved from has nothing to close
      co_await serve(std::move(stream));
    } else if (is_plain_http(error)) {
      co_await answer(stream.next_layer(), plain_reply(400, "this port speaks https"), {});
      beast::get_lowest_layer(stream).socket().shutdown(tcp::socket::shutdown_send, error);
    }
  }

  // One connection: requests, until one of them asks for a WebSocket.
  template <class Stream>
  asio::awaitable<void> serve(Stream stream) {
    std::optional<Ender> ender(std::in_place, *this,
                               [&stream] { beast::get_lowest_layer(stream).close(); });
    beast::flat_buffer buffer(kHeadersMax + 1024);
    while (!stopping) {
      http::request_parser<http::empty_body> parser;
      parser.header_limit(kHeadersMax);
      parser.body_limit(0);
      beast::get_lowest_layer(stream).expires_after(options.request_patience);
      auto [error, size] = co_await http::async_read(stream, buffer, parser, kAwait);
      if (error && error != http::error::body_limit) {
        if (error == http::error::header_limit || error == http::error::buffer_overflow)
          co_await answer(stream, plain_reply(431, "the request's headers are too long"), {});
        break;
      }
      ++counters.requests;
      const HttpRequest& request = parser.get();
      if (error) {
        co_await answer(stream, plain_reply(413, "no request here has a body"), request);
        break;
      }
      if (websocket::is_upgrade(request)) {
        auto decided = handlers.open(request_of(request));
        if (const Reply* refusal = std::get_if<Reply>(&decided)) {
          co_await answer(stream, *refusal, request);
          break;
        }
        ender.reset();
        co_await talk(std::move(stream), request, std::move(std::get<Accepted>(decided)));
        co_return;
      }
      const bool reads =
          request.method() == http::verb::get || request.method() == http::verb::head;
      const Reply reply =
          reads ? handlers.get(request_of(request)) : plain_reply(405, "GET and HEAD only");
      if (!co_await answer(stream, reply, request)) break;
    }
    error_code ignored;
    beast::get_lowest_layer(stream).socket().shutdown(tcp::socket::shutdown_send, ignored);
  }

  // Returns whether the connection stays open.
  template <class Stream>
  asio::awaitable<bool> answer(Stream& stream, const Reply& reply, const HttpRequest& request) {
    HttpResponse response = response_of(reply, request);
    http::response_serializer<http::string_body> serializer(response);
    beast::get_lowest_layer(stream).expires_after(options.request_patience);
    auto [error, size] = request.method() == http::verb::head
                             ? co_await http::async_write_header(stream, serializer, kAwait)
                             : co_await http::async_write(stream, serializer, kAwait);
    co_return !error && response.keep_alive();
  }

  template <class Stream>
  asio::awaitable<void> talk(Stream stream, HttpRequest request, Accepted accepted) {
    const std::shared_ptr<WebClient> client = std::move(accepted.client);
    beast::get_lowest_layer(stream).expires_never();
    websocket::stream<Stream> socket(std::move(stream));
    asio::steady_timer end(*io, Clock::time_point::max());
    const Ender ender(*this, [&socket, &end] {
      beast::get_lowest_layer(socket).close();
      end.expires_at(Clock::now());
    });
    websocket::stream_base::timeout patience{};
    patience.handshake_timeout = options.request_patience;
    patience.idle_timeout = options.idle_patience;
    patience.keep_alive_pings = true;
    socket.set_option(patience);
    socket.read_message_max(0);  // `listen` counts: Beast's own goodbye would be lost (README.md)
    socket.auto_fragment(false);
    socket.set_option(
        websocket::stream_base::decorator([&accepted](websocket::response_type& response) {
          response.set(http::field::server, "sutured");
          response.set(http::field::sec_websocket_protocol, accepted.subprotocol);
        }));
    if (auto [error] = co_await socket.async_accept(request, kAwait); error) co_return;

    // In Beast a close waits for the read that is under way, and a read that meets nonsense then
    // waits for the close: for ever, though the socket be closed. The end cancels both.
    using asio::experimental::awaitable_operators::operator||;
    co_await (converse(socket, *client, end) || until(end));
  }

  /// Lets `end` come with itself: of two that are waited for, one that fails does not end the
  /// other.
  class Ending {
   public:
    explicit Ending(asio::steady_timer& end) : end_(end) {}
    ~Ending() {
      try {
        end_.expires_at(Clock::now());
      } catch (const std::exception&) {  // a timer of this kind can always be set
      }
    }
    Ending(const Ending&) = delete;
    Ending& operator=(const Ending&) = delete;

   private:
    asio::steady_timer& end_;
  };

  /// Both ways at once, until either is over; `end` comes then, if it has not brought that about.
  template <class Socket>
  asio::awaitable<void> converse(Socket& socket, WebClient& client, asio::steady_timer& end) {
    const Ending ending(end);
    asio::steady_timer bell(*io, Clock::time_point::max());
    const Presence presence(*this, client, bell);
    bool over = false;
    std::optional<Close> refusal;
    using asio::experimental::awaitable_operators::operator&&;
    try {
      co_await (listen(socket, client, over, refusal) &&
                speak(socket, client, bell, end, over, refusal));
    } catch (const asio::multiple_exceptions& both) {  // the second was cancelled by the first
      note(both.first_exception());
    } catch (...) {
      note(std::current_exception());
    }
  }

  /// Returns when `end` has come, whenever it was set to.
  static asio::awaitable<void> until(asio::steady_timer& end) {
    while (end.expiry() > Clock::now()) co_await end.async_wait(kAwait);
  }

  /// `refusal` becomes why the client is heard no more, for `speak` to say.
  template <class Socket>
  asio::awaitable<void> listen(Socket& socket, WebClient& client, bool& over,
                               std::optional<Close>& refusal) {
    // Piece by piece: Beast's read of a whole message does not bear a close that begins between two
    // of them, reads too, and passes over the rest.
    beast::flat_buffer message(kMessageMax + kPiece);
    while (!over) {
      auto [error, size] = co_await socket.async_read_some(message.prepare(kPiece), kAwait);
      if (error) break;
      message.commit(size);
      if (message.size() > kMessageMax) {
        refusal = Close{1009, "a message is longer than 64 KiB"};
        client.wake();
        co_return;
      }
      if (!socket.is_message_done()) continue;
      counters.bytes_received += message.size();
      const std::string_view body(static_cast<const char*>(message.cdata().data()), message.size());
      if (socket.got_text()) {
        client.on_text(body);
      } else {
        client.on_binary(std::as_bytes(std::span(body)));
      }
      message.consume(message.size());
    }
    over = true;
    client.wake();
  }

  template <class Socket>
  asio::awaitable<void> speak(Socket& socket, WebClient& client, asio::steady_timer& bell,
                              asio::steady_timer& end, bool& over,
                              const std::optional<Close>& refusal) {
    while (!over) {
      if (const auto close = stopping  ? std::optional(Close{1001, "the server ends"})
                             : refusal ? refusal
                                       : client.closing()) {
        websocket::close_reason reason;
        reason.code = close->code;
        reason.reason = close->reason.substr(0, 120);
        end.expires_after(options.request_patience);
        over = true;  // Beast's close reads too: no other read begins beside it
        co_await socket.async_close(reason, kAwait);
        break;
      }
      const std::optional<Outgoing> message = client.next();
      if (!message) {
        co_await bell.async_wait(kAwait);
        continue;
      }
      const std::span<const std::byte> body = message->body.bytes();
      const std::array<asio::const_buffer, 2> parts{asio::buffer(message->head),
                                                    asio::buffer(body.data(), body.size())};
      socket.text(message->text);
      auto [error, size] = co_await socket.async_write(parts, kAwait);
      if (error) break;
      counters.bytes_sent += size;
    }
    over = true;
    beast::get_lowest_layer(socket).close();  // ends a read that still waits
  }

  asio::awaitable<void> beat(std::chrono::milliseconds period, std::function<void()> task) {
    asio::steady_timer timer(*io);
    const Ender ender(*this, [&timer] { timer.cancel(); });
    while (!stopping) {
      timer.expires_after(period);
      co_await timer.async_wait(kAwait);
      if (!stopping) guard(task);
    }
  }

  Options options;
  Handlers handlers;
  WebCounters counters;
  std::list<WebClient*> clients;
  std::list<std::function<void()>> enders;
  std::optional<Clock::time_point> told;  // of a fault
  bool stopping = false;
  std::uint16_t port = 0;
  std::optional<asio::ssl::context> tls;
  std::optional<asio::io_context> io;
  std::optional<tcp::acceptor> acceptor;
};

WebServer::WebServer(const Options& options, Handlers handlers)
    : state_(std::make_unique<State>(options, std::move(handlers))) {}

WebServer::~WebServer() = default;

std::uint16_t WebServer::port() const noexcept { return state_->port; }

void WebServer::run() {
  state_->spawn(state_->accept());
  state_->io->run();
}

void WebServer::stop() {
  State& state = *state_;
  asio::post(*state.io, [&state] {
    if (std::exchange(state.stopping, true)) return;
    error_code ignored;
    state.acceptor->close(ignored);
    for (WebClient* client : state.clients) client->wake();
    auto timer = std::make_shared<asio::steady_timer>(*state.io, kGoodbye);
    // Every wait ends, so every coroutine does, and `run` has nothing left to do.
    timer->async_wait([&state, timer](error_code) {
      for (const auto& end : state.enders) end();
    });
  });
}

void WebServer::post(std::function<void()> task) {
  asio::post(*state_->io, [state = state_.get(), task = std::move(task)] { state->guard(task); });
}

void WebServer::every(std::chrono::milliseconds period, std::function<void()> task) {
  state_->spawn(state_->beat(period, std::move(task)));
}

const WebCounters& WebServer::counters() const noexcept { return state_->counters; }

}  // namespace sutured::gateway
